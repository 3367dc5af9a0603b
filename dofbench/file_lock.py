"""Locks that die with their process, where the system and the file system have them."""

from __future__ import annotations

import errno

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
