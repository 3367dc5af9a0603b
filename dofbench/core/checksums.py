"""Checksums of files, kept in a cache, so that large folders can be verified every time that they are read.

A checksum is used again while the file has the same size, times and inode. The time of the last change of the inode
counts too: it can't be set back, unlike the time of the last change of the content.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from dofbench.core.files import sha256_file, sha256_text, write_text

# Seconds. A file that changed less long ago may change again within one tick of its file system's clock.
SETTLED = 2.0
_VERSION = 1


def cache_folder() -> Path | None:
    """The folder of this program's caches: dofbench in $XDG_CACHE_HOME, or else in ~/.cache; None for a user without a
    home, as a folder for everybody could be written by anybody."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(base) if Path(base).is_absolute() else Path("~/.cache").expanduser()) / "dofbench"
    except RuntimeError:
        return None


def checksums(root: Path, names: Iterable[str]) -> dict[str, str | None]:
    """sha256 of the files `root`/NAME, by name; None where there is no such file.

    A file that hasn't changed since it was last read isn't read again. A cache that is damaged, or can't be written, is
    as good as an empty one.
    """
    place = root.resolve()
    folder = cache_folder()
    file = None if folder is None else folder / "checksums" / f"{sha256_text(os.fsdecode(place))[:32]}.json"
    known, kept = {} if file is None else _read(file), {}
    found: dict[str, str | None] = {}
    now = time.time()
    for name in names:
        path = root / name
        if not path.is_file():
            found[name] = None
            continue
        state = _state(path)
        entry = known.get(name)
        digest = entry[-1] if entry is not None and entry[:-1] == state else sha256_file(path)
        found[name] = digest
        if now - max(state[-2:]) / 1e9 > SETTLED and _state(path) == state:
            kept[name] = [*state, digest]
    if file is not None and kept != known:
        with suppress(OSError):  # without a cache every file is read the next time as well
            write_text(file, json.dumps({"version": _VERSION, "folder": os.fsdecode(place), "files": kept}))
    return found


def _state(path: Path) -> list[int]:
    """What changes when a file does: device, inode, size, times of content and inode in ns."""
    seen = path.stat()
    return [seen.st_dev, seen.st_ino, seen.st_size, seen.st_mtime_ns, seen.st_ctime_ns]


def _read(file: Path) -> dict[str, list[Any]]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if content["version"] != _VERSION:
            return {}
        return {name: entry for name, entry in content["files"].items() if len(entry) == 6}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}
