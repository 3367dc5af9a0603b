"""Locks that die with their process, where the system and the file system have them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dofbench.core.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCKS = fcntl is not None
# What file systems without locks say, as some on networks.
_NONE_HERE = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}


def taken(handle: int, *, shared: bool = False, wait: bool = False) -> bool:
    """Take the lock on an open file or folder; False where another process holds it. wait: until it doesn't.

    True as well where there are no such locks: then nobody is kept out. Raises OSError for anything else.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NONE_HERE:
            raise
    return True


@contextmanager
def only_writer(root: Path) -> Iterator[None]:
    """Hold the folder against a second run on it. Raises InputError when another one has it.

    The lock dies with the process. Where there are no file locks the folder is not guarded.
    """
    if root.exists() and not root.is_dir():
        raise InputError(root, "a file", "a folder to write to")
    root.mkdir(parents=True, exist_ok=True)
    if not LOCKS:
        yield
        return
    handle = os.open(root, os.O_RDONLY)
    try:
        if not taken(handle):
            raise InputError(root, "another run that is writing it", "one run at a time")
        yield
    finally:
        os.close(handle)
