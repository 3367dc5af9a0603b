"""The vertices of a PLY file, ASCII or binary, and coloured points from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.readable import check_file

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# A hundred million vertices of ten floats.
_MOST_BYTES = 4 * 10**9
_LONGEST_HEADER = 1 << 16
_COLOURS = ("red", "green", "blue")


def read_ply(file: Path) -> PointCloud:
    """Read points x, y, z with red, green, blue (uchar, or floats in [0, 1]; mid-grey without). Error and tracks are
    unknown. Raises InputError for another format, a truncated file, NaN."""
    rows = read_vertices(file, "a PLY file with points")
    kind, count = rows.dtype, len(rows)
    xyz = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if not np.isfinite(xyz).all():
        raise InputError(file, "points with NaN or infinity", "finite coordinates")
    rgb = np.full((count, 3), 0.5, dtype=np.float32)
    if all(name in (kind.names or ()) for name in _COLOURS):
        rgb = np.stack([rows[name].astype(np.float32) for name in _COLOURS], axis=1)
        if kind["red"].kind == "u":
            rgb /= np.float32(np.iinfo(kind["red"]).max)
    return PointCloud(xyz, rgb, np.full(count, np.nan, dtype=np.float32))


def read_vertices(file: Path, expected: str) -> np.ndarray:
    """Read all properties of the vertices, x, y and z among them, as a structured array.

    expected: what the file should be, for the message. Raises InputError for another format or a truncated file.
    """
    head, body = _split(file, expected)
    order, count, fields = _header(head, file, expected)
    kind = np.dtype([(name, (order or "=") + code) for name, code in fields])
    return _ascii(body, count, kind, file) if not order else _binary(body, count, kind, file)


def read_comments(file: Path, expected: str) -> list[str]:
    """The header's comments, without the word. expected, errors: as `read_vertices`."""
    lines = _split(file, expected, most=_LONGEST_HEADER)[0].splitlines()
    return [line.removeprefix("comment").strip() for line in lines if line.split()[:1] == ["comment"]]


def _split(file: Path, expected: str, most: int = -1) -> tuple[str, bytes]:
    """(header, what follows its end). most: bytes to read, all where it is negative."""
    if (size := check_file(file, expected)) > _MOST_BYTES:
        raise InputError(file, f"{size} bytes", f"{expected} of {_MOST_BYTES} bytes at most")
    with file.open("rb") as stream:
        content = stream.read(most)
    head, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not mark:
        raise InputError(file, "no PLY header", expected)
    return head.decode("ascii", "replace"), body[2:] if body.startswith(b"\r\n") else body[1:]


def _header(text: str, file: Path, expected: str) -> tuple[str, int, list[tuple[str, str]]]:
    """(byte order or "", number of vertices, their properties); the vertices must come first."""
    order, count, fields, element = None, None, [], None
    for words in (line.split() for line in text.splitlines()[1:]):
        match words:
            case ["format", name, _]:
                order = _ORDERS.get(name)
            case ["element", name, number] if number.isdecimal() and number.isascii() and len(number) < 16:
                if count is None and name != "vertex":
                    raise InputError(file, f"element {name} first", "the vertices first")
                element, count = name, int(number) if name == "vertex" else count
            case ["property", code, name] if element == "vertex" and code in _TYPES:
                fields.append((name, _TYPES[code]))
            case ["property", *rest] if element == "vertex":
                raise InputError(file, f"vertex property {' '.join(rest)}", "numbers")
    if order is None or count is None:
        raise InputError(file, "a PLY header without format or vertices", expected)
    names = [name for name, _ in fields]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise InputError(file, f"vertex properties {', '.join(names) or 'none'}", "x, y, z, each once")
    return order, count, fields


def _binary(body: bytes, count: int, kind: np.dtype, file: Path) -> np.ndarray:
    if len(body) < count * kind.itemsize:
        raise InputError(file, f"{len(body)} bytes of vertices", f"{count * kind.itemsize}")
    return np.frombuffer(body, dtype=kind, count=count)


def _ascii(body: bytes, count: int, kind: np.dtype, file: Path) -> np.ndarray:
    # A line of a number and its end is two bytes at least: what is announced beyond that isn't there.
    if count > len(body):
        raise InputError(file, f"{len(body)} bytes of vertices", f"{count} lines")
    lines = body.decode("ascii", "replace").splitlines()[:count]
    rows = [line.split() for line in lines]
    width = len(kind.names or ())
    if len(rows) < count or any(len(row) != width for row in rows):
        found = f"{len(rows)} lines of vertices or a line cut short"
        raise InputError(file, found, f"{count} lines of {width} numbers")
    try:
        values = np.array(rows, dtype=np.float64).reshape(count, width)
    except ValueError as error:
        raise InputError(file, str(error), "numbers") from None
    table = np.empty(count, dtype=kind)
    for column, name in enumerate(kind.names or ()):
        if kind[name].kind in "iu":
            range_ = np.iinfo(kind[name])
            # NaN compares false.
            if not ((values[:, column] >= range_.min) & (values[:, column] <= range_.max)).all():
                raise InputError(file, f"vertex property {name} beyond its type", f"{range_.min} to {range_.max}")
        with np.errstate(over="ignore"):
            table[name] = values[:, column]
    return table
