"""Leases on folders: they show which process works on a folder, between processes of one machine and between machines.

A lease is a file in the folder. Its owner holds the system's lock on the file, and updates the file's modification time
every few seconds. The lock is released when the process dies, so other processes of the same machine notice this at
once. Other machines, which often don't see locks over a network, notice it when the file hasn't been updated for some
time.

Files are numbered. A process that finds the owner of the latest lease dead creates the file with the next number, which
on every file system succeeds for one process only. A dead file is never renamed or overwritten, so a process that
judged it dead earlier can't take away the lease of another process since.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import random
import re
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

from dofbench.core.errors import InputError
from dofbench.core.file_lock import Lock, ask
from dofbench.core.files import TEMPORARY, files_below, read_json

RENEWED_EVERY = 15.0  # seconds
EXPIRES_AFTER = 120.0  # seconds without renewal; longer than the delay of a busy machine or of a network's cache
_POLL = 0.25  # seconds between two checks of a process that waits
_NAME = re.compile(r"running(?:\.(\d+))?\.lock")
PATTERN = "running*.lock"
_UNNAMED = f"{TEMPORARY}lease."  # beginning of the names of files that aren't leases yet
# Errors of file systems without hard links.
_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}


class HeldElsewhere(InputError):
    """Another process holds the folder's lease."""


class Lease:
    """A lease that this process holds."""

    def __init__(self, file: Path, stream: BinaryIO):
        self._file, self._stream, self._over = file, stream, threading.Event()
        self._renewing = threading.Thread(target=self._renew, daemon=True)
        self._renewing.start()

    def check(self) -> None:
        """Raise InputError when another process has taken over the lease, so that this one must not write."""
        try:
            ours = os.path.samestat(os.fstat(self._stream.fileno()), self._file.stat())
        except FileNotFoundError:
            ours = False
        if not ours:
            raise InputError(
                self._file.parent,
                f"another process that took this work over, as this one gave no sign of life for {EXPIRES_AFTER:.0f} s",
                "to be alone; the same command goes on with what the other one leaves",
            )

    def end(self) -> None:
        """Release the lease; a second call does nothing."""
        if self._over.is_set():
            return
        self._over.set()
        self._renewing.join()
        with suppress(InputError):  # if the lease was taken over, a file of that name belongs to another process
            self.check()
            self._file.unlink(missing_ok=True)
        self._stream.close()

    def _renew(self) -> None:
        while not self._over.wait(RENEWED_EVERY):
            with suppress(OSError):  # a temporary network failure; `check` notices if the lease was lost
                os.utime(self._stream.fileno() if os.utime in os.supports_fd else self._file)


@contextmanager
def leased(folder: Path, note: Mapping[str, Any], *, wait: bool = False) -> Iterator[Lease]:
    """Hold the folder's lease during the block. note: a record of the work, for a process that finds it after this one
    died.

    While another process holds the lease, this waits, or raises HeldElsewhere, an InputError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps({"process": os.getpid(), "host": platform.node(), "machine": _machine(), **note}).encode()
    tries = 0
    while (lease := _taken(folder, content)) is None:
        tries += 1
        # Two processes that created files at the same moment both withdraw; the next time one of them is first.
        if not wait and (tries > 3 or at_work(folder)):
            raise HeldElsewhere(folder, "another process at work on the same run", "to be alone")
        time.sleep(_POLL * random.uniform(0.5, 1.5) if wait else random.uniform(0.01, 0.1))
    try:
        yield lease
    finally:
        lease.end()


def at_work(folder: Path) -> bool:
    """Whether a living process, of this machine or another one, holds the folder's lease."""
    return any(_alive(file, time.time()) for file in _files(folder))


def left_note(folder: Path) -> tuple[Path, Any] | None:
    """The file of the folder's latest lease and its record; None without a lease.

    Raises InputError for a damaged file.
    """
    files = _files(folder)
    return (files[-1], read_json(files[-1])) if files else None


def leased_folders(root: Path) -> list[Path]:
    """Folders at or below `root` with a lease, whose process is working or has died."""
    return sorted({file.parent for file in files_below(root, PATTERN) if _NAME.fullmatch(file.name)})


def _files(folder: Path) -> list[Path]:
    """The folder's lease files, the latest last."""
    return sorted((file for file in folder.glob(PATTERN) if _NAME.fullmatch(file.name)), key=_number)


def _number(file: Path) -> int:
    found = _NAME.fullmatch(file.name)
    return int(found[1]) if found and found[1] else 1


def _taken(folder: Path, content: bytes) -> Lease | None:
    """A new lease; None if another process holds one or is just acquiring one."""
    handle, name = tempfile.mkstemp(prefix=_UNNAMED, dir=folder)
    stream, temporary = os.fdopen(handle, "wb"), Path(name)
    kept = False
    try:
        # Locked before the file has a name that others look for, so that nobody sees it without its lock. A process
        # that clears away what the dead left may have taken the file for such: then this one tries again.
        if ask(stream.fileno()) is Lock.THEIRS:
            return None
        stream.write(content)
        stream.flush()
        temporary.chmod(0o644)  # other users who share the folder must be able to read the lease
        # All ages are computed by the clock of the machine with the disk, since clocks of machines may differ by
        # minutes.
        now = os.fstat(stream.fileno()).st_mtime
        found = _files(folder)
        if any(_alive(file, now) for file in found):
            return None
        number = _number(found[-1]) + 1 if found else 1
        target = folder / ("running.lock" if number == 1 else f"running.{number}.lock")
        if not _named(temporary, target):
            return None
        others = [file for file in _files(folder) if file != target]
        if any(_alive(file, now) for file in others):
            target.unlink(missing_ok=True)
            return None
        # Besides old leases there may be files of processes that died before they could give them a name.
        unnamed = (file for file in folder.glob(f"{_UNNAMED}*") if file != temporary and not _alive(file, now))
        for file in (*others, *unnamed):
            file.unlink(missing_ok=True)
        kept = True
        return Lease(target, stream)
    finally:
        temporary.unlink(missing_ok=True)
        if not kept:
            stream.close()


def _named(temporary: Path, target: Path) -> bool:
    """Give the file the name `target` unless a file of that name exists; the complete file appears at once."""
    try:
        os.link(temporary, target)
    except (FileExistsError, FileNotFoundError):  # FileNotFoundError: cleared away by another process
        return False
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        try:
            os.close(os.open(target, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        temporary.replace(target)
    return True


def _alive(file: Path, now: float) -> bool:
    """Whether the lease's owner is alive at the time `now`, by the clock of the file's disk."""
    if not file.is_file():  # a FIFO would never open
        return False
    try:
        stream = file.open("rb")
    except FileNotFoundError:
        return False
    with stream:
        lock = ask(stream.fileno(), shared=True)
        if lock is not Lock.NONE and _of_this_machine(stream):
            return lock is Lock.THEIRS
        # Locks of other machines can't be relied on: a network may not transmit them, or keep them after the machine's
        # end.
        return now - os.fstat(stream.fileno()).st_mtime < EXPIRES_AFTER


def _of_this_machine(stream: BinaryIO) -> bool:
    try:
        note = json.loads(stream.read())
        # Leases without this entry are older, and held on one machine only.
        return note.get("machine", _machine()) == _machine()
    except (ValueError, AttributeError, RecursionError):  # damaged by a process that died while writing
        return True


@cache
def _machine() -> str:
    """An id of the running system, which is equal for processes that see each other's locks. A host name isn't enough,
    as containers and cloned machines may have the same."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:  # not Linux
        return platform.node()
