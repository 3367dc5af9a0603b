"""What the C library does with memory that a training has freed: keep it, instead of giving it back."""

from __future__ import annotations

import ctypes
import sys

# Names and numbers of glibc's mallopt (malloc.h), and what a training sets.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_SETTINGS = {_TRIM_THRESHOLD: 2**31 - 1, _TOP_PAD: 2**26, _MMAP_THRESHOLD: 2**30}


def keep_freed_memory() -> bool:
    """Keep what is freed for the next allocation. Returns whether the C library took the settings: other libraries than
    glibc have none.

    A step of a network on every pixel or Gaussian makes and drops tensors of ten megabytes by the dozen. glibc gives
    each back to the system and asks for it again, and the system fills it with zeros page by page: a tenth of the time
    of such a training. Memory in use is the same; what a process holds stays at its most.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return False
    taken = [mallopt(name, value) for name, value in _SETTINGS.items()]
    return all(taken)
