"""Writing so that a crash never leaves half a file, and checksums."""

from __future__ import annotations

import csv
import errno
import fnmatch
import hashlib
import io
import json
import os
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError
from dofbench.core.readable import parse_json, read_text

# Beginning of the names of files and folders that are being written. Only such are taken for what a killed run left.
TEMPORARY = ".dofbench-"
# The umask can't be read without setting it, and it is the whole process's.
_UMASK = threading.Lock()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; rename it to `path` when the block succeeds.

    The temporary name keeps the suffix, because image writers choose the format by it. Raises InputError where `path`
    is a folder.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f"{TEMPORARY}{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    # mkstemp makes the file private to its owner; a dataset is meant to be shared.
    with _UMASK:
        umask = os.umask(0)
        os.umask(umask)
    temporary = Path(name)
    temporary.chmod(0o666 & ~umask)
    try:
        yield temporary
        temporary.replace(path)
    except IsADirectoryError:
        raise InputError(path, "a folder", "a file, which is replaced, or nothing") from None
    except OSError as error:
        # A failed write names no file, and the temporary one means nothing to the user.
        if error.errno is not None and error.filename in (None, name):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def temporaries(root: Path) -> list[Path]:
    """Files and folders at or below `root` that `replacing` and its like were writing; folders that are links aren't
    looked into."""
    return sorted(root.rglob(f"{TEMPORARY}*"))


def drop_temporaries(root: Path) -> None:
    """Remove what a killed run was writing, and nothing else."""
    for path in temporaries(root):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def refuse_links_outside(root: Path) -> None:
    """Raise InputError for a folder below `root` that is a link to one outside: what is written or deleted by its name
    would be somewhere else. `root` itself may be a link, as a disk may be too small for results."""
    place = root.resolve()
    for parent, folders, _ in os.walk(root):
        for name in folders:
            path = Path(parent, name)
            if path.is_symlink() and not path.resolve().is_relative_to(place):
                raise InputError(path, f"a link to {path.resolve()}", "a folder inside, as files are written to it")


def refused(path: Path, temporary: Path, message: str) -> OSError:
    """Why a library could not write `path`, as the system says it and the library doesn't.

    temporary: the file that it was writing. A full disk, a quota or a file that has become read-only refuses a few
    plain bytes too, with its error number; otherwise it is an input/output error with the library's message.
    """
    try:
        with temporary.open("ab") as stream:
            stream.write(bytes(1 << 20))
    except OSError as error:
        return OSError(error.errno, error.strerror, str(path))
    return OSError(errno.EIO, f"cannot be written ({message})", str(path))


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8, atomically. Raises InputError for text that UTF-8 can't hold: part of a file's name."""
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        found = f"a name that isn't UTF-8 ({text[max(0, error.start - 20) : error.end + 20]!r})"
        raise InputError(path, found, "names in UTF-8") from None
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no spaces: equal values give equal text, so it can be hashed."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON, atomically. Non-finite numbers are kept as NaN, Infinity, -Infinity."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows, column -> value, atomically; a column that a row lacks is empty, a float has eight digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:  # mostly of texts and gaps, where there are many
        values = map(row.get, columns)
        writer.writerow([value if value is None or value.__class__ is str else _csv_cell(value) for value in values])
    write_text(path, stream.getvalue())


def _csv_cell(value: object) -> object:
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else f"{value:.8g}"
    return value


def sha256_text(text: str) -> str:
    """Hexadecimal sha256 of the UTF-8 text."""
    return hashlib.sha256(text.encode()).hexdigest()


def sha256_file(path: Path) -> str:
    """Hexadecimal sha256 of a file's bytes."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def files_below(root: Path, pattern: str) -> list[Path]:
    """Files at or below a folder whose names match `pattern`, sorted; none where there is no such folder.

    Folders that are links are looked into as well, as results may lie on another disk. A folder that several paths lead
    to counts once, so that a link to a folder above it doesn't lead round in a circle.
    """
    found, seen = [], set()
    for parent, folders, names in os.walk(root, followlinks=True):
        folders.sort()
        place = os.path.realpath(parent)
        if place in seen:
            folders.clear()
            continue
        seen.add(place)
        found += [Path(parent, name) for name in fnmatch.filter(names, pattern)]
    return sorted(found)


def read_json(path: Path) -> Any:
    """Read a JSON file, as `core/readable.py` bounds it; raises InputError when it is absent or isn't JSON."""
    return parse_json(read_text(path, "a JSON file"), path)
