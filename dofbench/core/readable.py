"""Files read with bounds: none that never ends, none that takes more memory than its kind ever needs.

A scene, a dataset or a result may come from a stranger, or from a copy that went wrong. Whatever such a file says of
itself (a size, a count, a depth of nesting) is compared with what the file can hold before memory is taken for it.
"""

from __future__ import annotations

import json
import math
import stat
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from dofbench.core.errors import InputError

# Of an image, from its header: more than any camera takes (a phone 200, medium format 150 megapixels).
MOST_PIXELS = 250_000_000
# Of an image or array: float32 values in 4 GB.
MOST_VALUES = 1_000_000_000
# Of a text: a transforms.json of 100 000 views is a tenth of it.
MOST_TEXT = 512 * 2**20
# Digits of an integer in JSON; 10 to the power of 308 still fits into a double.
_MOST_DIGITS = 308
# Levels of lists and objects in JSON; our own files have up to ten.
_DEEPEST = 100
_KINDS = (
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISDIR, "a folder"),
)


def check_file(path: Path, expected: str) -> int:
    """The size in bytes of a regular file, or of one that a link leads to.

    Raises InputError for anything else, before it is opened: a FIFO without a writer would never open, and a device
    never ends. So it does for a path that isn't UTF-8, which no library takes and no manifest holds.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(path, "a path that isn't UTF-8", f"{expected}, under a name in UTF-8") from None
    try:
        status = Path(path).stat()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        found = (error.strerror or "").lower() if isinstance(error, OSError) else str(error)
        raise InputError(path, "no such file" if isinstance(error, FileNotFoundError) else found, expected) from None
    for is_kind, found in _KINDS:
        if is_kind(status.st_mode):
            raise InputError(path, found, expected)
    return status.st_size


def read_bytes(path: Path, expected: str, most: int | None = None) -> bytes:
    """The content of a regular file. most: bytes, None for no bound. Raises InputError."""
    size = check_file(path, expected)
    if most is not None and size > most:
        raise InputError(path, f"{size} bytes", f"{expected} of {most} bytes at most")
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(path, error.strerror or "no readable file", expected) from None


def read_text(path: Path, expected: str) -> str:
    """A UTF-8 text of 512 MB at most, without a byte order mark. Raises InputError."""
    try:
        return read_bytes(path, expected, MOST_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"no UTF-8 text ({error.reason} at byte {error.start})", expected) from None


def parse_json(text: str, subject: object, expected: str = "a JSON file") -> Any:
    """Plain data from JSON. Raises InputError about `subject` for what is none, for nesting deeper than can be read,
    for integers that no double can hold, and for text that no UTF-8 file can hold (half of a surrogate pair)."""
    try:
        data = json.loads(text, parse_int=_integer)
        if "\\u" in text:
            json.dumps(data, ensure_ascii=False).encode()
        _check_depth(data)
    except RecursionError:
        raise InputError(subject, f"JSON nested deeper than {_DEEPEST} levels", expected) from None
    except UnicodeEncodeError:
        raise InputError(subject, "half of a surrogate pair in a text", expected) from None
    except ValueError as error:
        raise InputError(subject, f"no JSON ({error})", expected) from None
    return data


def read_toml(path: Path, expected: str) -> dict[str, Any]:
    """Plain data of a TOML file, bounded as JSON is. Raises InputError."""
    text = read_text(path, expected)
    try:
        data = tomllib.loads(text)
        _check_depth(data)
    except RecursionError:
        raise InputError(path, f"TOML nested deeper than {_DEEPEST} levels", expected) from None
    except ValueError as error:
        raise InputError(path, f"no TOML ({error})", expected) from None
    return data


def _check_depth(data: Any) -> None:
    """Raise RecursionError for containers nested too deep: what walks or copies them later would fail then."""
    level, depth = [data], 0
    while level:
        if depth > _DEEPEST:
            raise RecursionError
        insides = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        level = [part for inside in insides for part in inside if isinstance(part, dict | list)]
        depth += 1


def _integer(digits: str) -> int:
    if len(digits) > _MOST_DIGITS:
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def check_pixels(subject: object, width: float, height: float, channels: int = 1) -> None:
    """Raise InputError for an image size beyond `MOST_PIXELS` or `MOST_VALUES`."""
    if width * height > MOST_PIXELS or width * height * channels > MOST_VALUES:
        found = f"an image of {width:.15g} x {height:.15g} pixels and {channels} channels"
        limit = f"at most {MOST_PIXELS // 10**6} megapixels, and {MOST_VALUES // 10**6} million values"
        raise InputError(subject, found, limit)


def read_array(path: Path, expected: str) -> np.ndarray:
    """The array in an .npy file, of numbers; it can't be written to. Raises InputError where the file isn't one, isn't
    as long as its header says, or holds Python objects."""
    size = check_file(path, expected)
    with _damage(path, expected), Path(path).open("rb") as stream:
        if zipfile.is_zipfile(stream):
            raise ValueError("an archive of several arrays")
        stream.seek(0)
        return _array(stream, size)


def read_arrays(path: Path, expected: str) -> dict[str, np.ndarray]:
    """The arrays in an .npz file by name, each read and checked as `read_array` does. Raises InputError."""
    check_file(path, expected)
    arrays = {}
    with _damage(path, expected), zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = np.array(_array(stream, member.file_size))
    return arrays


@contextmanager
def _damage(path: Path, expected: str) -> Iterator[None]:
    try:
        yield
    except MemoryError:
        raise
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    # Headers are Python literals, archives are compressed: damaged ones raise nearly anything.
    except Exception as error:
        reason = " ".join(str(error).split()[:20]) or type(error).__name__
        raise InputError(path, f"no readable array ({reason})", expected) from None


def _array(stream: IO[bytes], size: int) -> np.ndarray:
    """An array of `size` bytes with its header, which is read first: no memory is taken for what isn't there."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the format")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, columns_first, kind = header(stream)
    start = stream.tell()
    if kind.hasobject or kind.subdtype is not None or kind.kind not in "biufcU":
        raise ValueError(f"values of type {kind}")
    count = math.prod(shape)
    if min(shape, default=1) < 0 or count > MOST_VALUES:
        raise ValueError(f"an array of shape {shape}, at most {MOST_VALUES} values")
    if size - start != count * kind.itemsize:
        raise ValueError(f"{size - start} bytes for an array of {count * kind.itemsize}")
    values = np.frombuffer(stream.read(), dtype=kind) if count else np.empty(0, dtype=kind)
    return values.reshape(shape[::-1]).T if columns_first else values.reshape(shape)
