"""Focus distance in a photograph's EXIF: SubjectDistance, or the maker note.

OpenImageIO reads SubjectDistance. ExifRead reads the maker notes of Canon and Nikon; OpenImageIO 3.2 reads Canon's too,
but takes a neighbouring number for the distance. Nikon encrypts the distance in bodies after the D70 and D2 series, and
what Sony and Fujifilm write isn't documented: such a distance is unknown.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, cast

from dofbench.core.image_files.exif import LEAST

# Metres. EXIF writes infinity as the largest numerator, over any denominator; no lens tells this distance from it.
_INFINITE = 4000.0
_CANON_INFINITE = 0xFFFF  # centimetres
_MOST_READS = 200_000  # of a file's directory: an intact maker note takes a few thousand, a damaged one may loop
_LARGEST_READ = 1 << 20  # bytes
# Numbers of the words that ExifRead's tables of Canon's directories lack, after ExifTool's documentation of the tags
# ShotInfo and FileInfo.
_CANON_WORDS = {
    0x0004: {19: "ShotDistanceUpper", 20: "ShotDistanceLower"},
    0x0093: {20: "FileDistanceUpper", 21: "FileDistanceLower"},
}
_NIKON_PLAIN = (b"0101",)  # versions of LensData that aren't encrypted and have a distance
_NIKON_DISTANCE = 9  # its byte


class _Limited:
    """A file with limits on reads, since damaged directories lead anywhere."""

    def __init__(self, stream: BinaryIO):
        self._stream, self._left = stream, _MOST_READS

    def read(self, count: int) -> bytes:
        """So many bytes, or those up to the end; raises EOFError if there is none, or for too many reads."""
        self._left -= 1
        data = self._stream.read(min(count, _LARGEST_READ)) if self._left > 0 and count >= 0 else b""
        if count and not data:
            raise EOFError
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """As a file's."""
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        """As a file's."""
        return self._stream.tell()


def focus_distance(file: Path, tags: Mapping[str, Any]) -> float | None:
    """Focus distance, m; inf for infinity; None where unknown or impossible. tags: EXIF by OpenImageIO's names."""
    written = _metres(tags.get("Exif:SubjectDistance"))
    if written is not None:
        return written
    make = str(tags.get("Make", "")).strip().upper()
    if make.startswith("CANON"):
        return _canon(_maker_note(file))
    return _nikon(_maker_note(file)) if make.startswith("NIKON") else None


def _metres(value: object) -> float | None:
    """Seven digits of a distance: OpenImageIO has them as float32."""
    if not isinstance(value, int | float) or not value >= LEAST:  # NaN compares false
        return None
    return math.inf if value >= _INFINITE else float(f"{value:.7g}")


def _canon(note: Mapping[str, Any]) -> float | None:
    """The middle, by disparity, of both ends of the zone that the lens reports, whatever their order."""
    for kind in ("File", "Shot"):
        upper, lower = (note.get(f"MakerNote {kind}Distance{end}") for end in ("Upper", "Lower"))
        if isinstance(upper, int) and upper:  # a lens that reports no distance leaves the first at zero
            ends = [end & _CANON_INFINITE for end in (upper, lower) if isinstance(end, int) and end]
            disparity = math.fsum(0.0 if end == _CANON_INFINITE else 100 / end for end in ends) / len(ends)
            return _metres(1 / disparity) if disparity else math.inf
    return None


def _nikon(note: Mapping[str, Any]) -> float | None:
    data = note.get("MakerNote LensData")
    if isinstance(data, list) and len(data) > _NIKON_DISTANCE and bytes(data[:4]) in _NIKON_PLAIN:
        step = data[_NIKON_DISTANCE]
        return _metres(0.01 * 10 ** (step / 40)) if step else None
    manual = note.get("MakerNote ManualFocusDistance")
    if isinstance(manual, list) and manual and isinstance(manual[0], Fraction) and manual[0].denominator:
        return _metres(float(manual[0]))
    return None


def _maker_note(file: Path) -> dict[str, Any]:
    """ExifRead's tags of the file; none if it can't be read."""
    import exifread
    from exifread.tags.makernote import canon

    logging.getLogger("exifread").setLevel(logging.CRITICAL)  # it would print what it can't read
    for directory, words in _CANON_WORDS.items():
        canon.OFFSET_TAGS[directory].update({word: (name, None) for word, name in words.items()})
    try:
        with file.open("rb") as stream:
            found = exifread.process_file(cast(BinaryIO, _Limited(stream)), details=True, extract_thumbnail=False)
    except Exception:  # of any kind, depending on what is damaged
        return {}
    values = {name: getattr(tag, "values", None) for name, tag in found.items()}
    return {name: value for name, value in values.items() if value is not None}
