"""Colour codes in files made of boxes (ISO base media, ISO/IEC 14496-12): MP4, MOV, HEIF, AVIF."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

# Boxes on the way to `colr`, and the bytes between their head and the boxes in them.
_INSIDE = {b"moov": 0, b"trak": 0, b"mdia": 0, b"minf": 0, b"stbl": 0, b"stsd": 8, b"meta": 4, b"iprp": 0, b"ipco": 0}
# A picture's entry in stsd has its size, compressor and so on before further boxes (14496-12, 12.1.3).
_ENTRY = 78
# No file has this many boxes above its pictures; a damaged one could pretend to.
_MOST = 10_000


def colour_codes(file: Path) -> tuple[int, int] | None:
    """(primaries, transfer curve) by the numbers of ITU-T H.273, from the first `colr` box that has them; else None."""
    with file.open("rb") as stream:
        end = stream.seek(0, 2)
        for content in _colours(stream, 0, end, [0]):
            if content[:4] in (b"nclx", b"nclc") and len(content) >= 8:
                return int.from_bytes(content[4:6], "big"), int.from_bytes(content[6:8], "big")
    return None


def is_box_file(file: Path) -> bool:
    """Whether a file begins as one made of boxes does, whatever it is called."""
    with file.open("rb") as stream:
        return stream.read(8)[4:] == b"ftyp"


def _colours(stream: BinaryIO, start: int, end: int, seen: list[int], *, entries: bool = False) -> Iterator[bytes]:
    while start + 8 <= end and seen[0] < _MOST:
        seen[0] += 1
        stream.seek(start)
        head = stream.read(16)
        size, kind, length = int.from_bytes(head[:4], "big"), head[4:8], 8
        if size == 1:
            size, length = int.from_bytes(head[8:16], "big"), 16
        last = end if size == 0 else start + size
        if last > end or last < start + length:
            return
        if kind == b"colr":
            stream.seek(start + length)
            yield stream.read(min(last - start - length, 16))
        elif entries or kind in _INSIDE:
            skipped = _ENTRY if entries else _INSIDE[kind]
            yield from _colours(stream, start + length + skipped, last, seen, entries=kind == b"stsd")
        start = last
