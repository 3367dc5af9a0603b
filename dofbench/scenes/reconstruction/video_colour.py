"""Refuses videos in colours that the decoder doesn't turn into sRGB's: HDR and wide gamuts."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from dofbench.core.errors import InputError
from dofbench.core.image_files.iso_boxes import colour_codes

# ITU-T H.273, tables 2 and 3. 0 and 2: not stated. BT.601's primaries are a hair's breadth from BT.709's.
_USUAL_PRIMARIES = (0, 1, 2, 4, 5, 6, 7)
_USUAL_CURVES = (0, 1, 2, 4, 5, 6, 7, 11, 12, 13, 14, 15)
_PRIMARIES = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
_CURVES = {8: "linear light", 16: "PQ (HDR)", 18: "HLG (HDR)"}
_TONES = "zscale=t=linear:npl=100,tonemap=hable,"
_CONVERT = "ffmpeg -i {} -vf {}zscale=p=bt709:t=bt709:m=bt709:r=tv,format=yuv420p -crf 14 SDR.mp4"
# EBML (RFC 8794) and Matroska (RFC 9559, 5.1.4.1.28.16): the elements on the way to a track's colour.
_MATROSKA = (".mkv", ".webm")
_INSIDE = (0x18538067, 0x1654AE6B, 0xAE, 0xE0, 0x55B0)
_CURVE_ID, _PRIMARIES_ID, _CLUSTER = 0x55BA, 0x55BB, 0x1F43B675


def check_colours(path: Path) -> None:
    """Raise InputError, with the command that converts it, for a video that says it is HDR or in a wide gamut."""
    codes = _matroska_codes(path) if path.suffix.lower() in _MATROSKA else colour_codes(path)
    if codes is None:
        return
    primaries, curve = codes
    if primaries in _USUAL_PRIMARIES and curve in _USUAL_CURVES:
        return
    said = [
        _PRIMARIES.get(primaries, "" if primaries in _USUAL_PRIMARIES else f"primaries {primaries}"),
        _CURVES.get(curve, "" if curve in _USUAL_CURVES else f"transfer curve {curve}"),
    ]
    command = _CONVERT.format(path.name, _TONES if curve in (16, 18) else "")
    raise InputError(
        path, f"a video in {' with '.join(filter(None, said))}", f"SDR in BT.709; convert it first: {command}"
    )


def _matroska_codes(path: Path) -> tuple[int, int] | None:
    found: dict[int, int] = {}
    with path.open("rb") as stream:
        _read_elements(stream, stream.seek(0, 2), 0, found)
    if not found:
        return None
    return found.get(_PRIMARIES_ID, 2), found.get(_CURVE_ID, 2)


def _read_elements(stream: BinaryIO, end: int, start: int, found: dict[int, int]) -> None:
    """Collect the codes among the elements from `start` to `end`, up to the first cluster of pictures."""
    while start < end:
        stream.seek(start)
        kind, first = _number(stream, keep_mark=True)
        size, second = _number(stream, keep_mark=False)
        if kind is None or size is None or kind == _CLUSTER:
            return
        inside = start + first + second
        unknown = size == (1 << (7 * second)) - 1
        last = end if unknown else min(end, inside + size)
        if kind in _INSIDE:
            _read_elements(stream, last, inside, found)
        elif kind in (_CURVE_ID, _PRIMARIES_ID) and size <= 8:
            found.setdefault(kind, int.from_bytes(stream.read(size), "big"))
        start = last


def _number(stream: BinaryIO, *, keep_mark: bool) -> tuple[int | None, int]:
    """A number of EBML, whose first bit set says how long it is, and its bytes; None at the end and where damaged."""
    head = stream.read(1)
    if not head or not head[0]:
        return None, 1
    length = 9 - head[0].bit_length()
    rest = stream.read(length - 1)
    if len(rest) < length - 1:
        return None, length
    mark = 0 if keep_mark else 0x80 >> (length - 1)
    return int.from_bytes(bytes([head[0] & ~mark]) + rest, "big"), length
