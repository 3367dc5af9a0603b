"""Locks that die with their process, where the system and the file system have them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path

from dofbench.core.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# What file systems without locks say, as some on networks.
_NONE_HERE = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}


class Lock(Enum):
    """What became of asking for a lock. `NONE`: there are no locks here, so it is unknown."""

    OURS = "ours"
    THEIRS = "another process has it"
    NONE = "no locks here"


def ask(handle: int, *, shared: bool = False) -> Lock:
    """Ask for the lock on an open file or folder, without waiting. Raises OSError where the system gives no answer."""
    if fcntl is None:
        return Lock.NONE
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return Lock.THEIRS
    except OSError as error:
        if error.errno not in _NONE_HERE:
            raise
        return Lock.NONE
    return Lock.OURS


@contextmanager
def only_writer(root: Path) -> Iterator[None]:
    """Hold the folder against a second run on it. Raises InputError when another one has it.

    The lock dies with the process. Where there are no file locks the folder is not guarded.
    """
    if root.exists() and not root.is_dir():
        raise InputError(root, "a file", "a folder to write to")
    root.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        yield
        return
    handle = os.open(root, os.O_RDONLY)
    try:
        if ask(handle) is Lock.THEIRS:
            raise InputError(root, "another run that is writing it", "one run at a time")
        yield
    finally:
        os.close(handle)
