"""Locks on folders, by filelock: the system releases them when their process dies, also of another machine where the
disk that they share has locks over the network. The lock's file goes with the work."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from dofbench.core.errors import InputError

_BRIEFLY = 0.5  # s: who only asks whether a lock is held holds it for a moment
FOLDER_LOCK = ".lock"  # a file in a folder that a process writes, until it has ended well


class HeldElsewhere(InputError):
    """Another process holds the lock."""


@contextmanager
def locked(file: Path, found: str, expected: str) -> Iterator[None]:
    """Hold the lock whose file this is. Raises HeldElsewhere with `found` and `expected` where another process does."""
    file.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(file)
    try:
        lock.acquire(timeout=_BRIEFLY)
    except Timeout:
        raise HeldElsewhere(file.parent, found, expected) from None
    try:
        yield
    finally:
        # While it is held: who gets the lock of a file that is gone notices, and tries again.
        file.unlink(missing_ok=True)
        lock.release()


def is_locked(file: Path) -> bool:
    """Whether a living process holds the lock whose file this is."""
    if not file.is_file():
        return False
    try:
        with FileLock(file).acquire(timeout=0):
            return False
    except Timeout:
        return True


@contextmanager
def only_writer(root: Path) -> Iterator[None]:
    """Hold the folder against a second run on it. Raises InputError when another one has it."""
    if root.exists() and not root.is_dir():
        raise InputError(root, "a file", "a folder to write to")
    if root.is_dir() and not os.access(root, os.W_OK):
        yield  # nobody here can write, so there is nothing to guard
        return
    with locked(root / FOLDER_LOCK, "another run that is writing it", "one run at a time"):
        yield
