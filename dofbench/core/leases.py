"""Who is at work on a folder: leases, which hold between the processes of one machine and between machines.

A lease is a file in the folder. Its owner holds the system's lock on that file, which ends with the process, and renews
the file's time of change every few seconds, which ends with the machine. So another process of the same machine sees at
once that an owner has died. A machine that shares the folder over a network, where locks often don't reach, sees it
when the file has grown old.

Files are numbered. Who finds the latest lease dead makes the file of the next number: every file system makes sure that
a file is new for one process alone. A dead file is never renamed or overwritten, so a process that judged it long ago
can't take away what another one has taken since.
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
from dofbench.core.files import read_json

RENEWED_EVERY = 15.0  # seconds
EXPIRES_AFTER = 120.0  # seconds without renewal; more than a machine under load or a network's cache may be late
_POLL = 0.25  # seconds between two looks of a process that waits
_NAME = re.compile(r"running(?:\.(\d+))?\.lock")
PATTERN = "running*.lock"
# What file systems say that have no second names for a file.
_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}


class HeldElsewhere(InputError):
    """Another process is at work there."""


class Lease:
    """One that this process holds."""

    def __init__(self, file: Path, stream: BinaryIO):
        self._file, self._stream, self._over = file, stream, threading.Event()
        self._renewing = threading.Thread(target=self._renew, daemon=True)
        self._renewing.start()

    def check(self) -> None:
        """Raise InputError when another process has taken the lease over: what is about to be written is its own."""
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
        """Give the lease back; a second time nothing happens."""
        if self._over.is_set():
            return
        self._over.set()
        self._renewing.join()
        with suppress(InputError):  # taken over: the file of that name, if there is one, is somebody else's
            self.check()
            self._file.unlink(missing_ok=True)
        self._stream.close()

    def _renew(self) -> None:
        while not self._over.wait(RENEWED_EVERY):
            with suppress(OSError):  # a network that is away for a moment; `check` says what it came to
                os.utime(self._stream.fileno() if os.utime in os.supports_fd else self._file)


@contextmanager
def leased(folder: Path, note: Mapping[str, Any], *, wait: bool = False) -> Iterator[Lease]:
    """Hold the folder's lease during the block. note: what is being done, for whoever finds it when this process died.

    While another process is at work there: waits, or raises HeldElsewhere, an InputError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps({"process": os.getpid(), "host": platform.node(), "machine": _machine(), **note}).encode()
    tries = 0
    while (lease := _taken(folder, content)) is None:
        tries += 1
        # Two processes that made files at one moment have both withdrawn; one of them comes first the next time.
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
    """The file of the folder's latest lease and what it says; None where there is none.

    Raises InputError for a damaged file.
    """
    files = _files(folder)
    return (files[-1], read_json(files[-1])) if files else None


def leased_folders(root: Path) -> list[Path]:
    """Folders at or below `root` in which a process is at work or has died."""
    return sorted({file.parent for file in root.rglob(PATTERN) if _NAME.fullmatch(file.name)})


def _files(folder: Path) -> list[Path]:
    """The folder's lease files, the latest last."""
    return sorted((file for file in folder.glob(PATTERN) if _NAME.fullmatch(file.name)), key=_number)


def _number(file: Path) -> int:
    found = _NAME.fullmatch(file.name)
    return int(found[1]) if found and found[1] else 1


def _taken(folder: Path, content: bytes) -> Lease | None:
    """A new lease; None where another process is at work, or is just about to be."""
    handle, name = tempfile.mkstemp(prefix=".lease.", dir=folder)
    stream, temporary = os.fdopen(handle, "wb"), Path(name)
    kept = False
    try:
        stream.write(content)
        stream.flush()
        temporary.chmod(0o644)  # other users may share the folder, and have to see that somebody is at work
        # Both ages are by the clock of the machine that has the disk: clocks of machines may differ by minutes.
        now = os.fstat(stream.fileno()).st_mtime
        found = _files(folder)
        if any(_alive(file, now) for file in found):
            return None
        number = _number(found[-1]) + 1 if found else 1
        target = folder / ("running.lock" if number == 1 else f"running.{number}.lock")
        ask(stream.fileno())  # before anybody can see the file, so that nobody sees it without its lock
        if not _named(temporary, target):
            return None
        others = [file for file in _files(folder) if file != target]
        if any(_alive(file, now) for file in others):
            target.unlink(missing_ok=True)
            return None
        for file in others:
            file.unlink(missing_ok=True)
        kept = True
        return Lease(target, stream)
    finally:
        temporary.unlink(missing_ok=True)
        if not kept:
            stream.close()


def _named(temporary: Path, target: Path) -> bool:
    """Give the file the name `target` unless there is one of that name. The whole file appears at once."""
    try:
        os.link(temporary, target)
    except FileExistsError:
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
    """Whether the lease's owner works on, as of `now` by the clock of the file's disk."""
    try:
        stream = file.open("rb")
    except FileNotFoundError:
        return False
    with stream:
        lock = ask(stream.fileno(), shared=True)
        if lock is not Lock.NONE and _of_this_machine(stream):
            return lock is Lock.THEIRS
        # Of another machine a lock says little: a network may not carry it, or keep it when the machine is gone.
        return now - os.fstat(stream.fileno()).st_mtime < EXPIRES_AFTER


def _of_this_machine(stream: BinaryIO) -> bool:
    try:
        note = json.loads(stream.read())
        # Leases of before this entry held on one machine alone.
        return note.get("machine", _machine()) == _machine()
    except (ValueError, AttributeError):  # damaged: by a process that died while it wrote
        return True


@cache
def _machine() -> str:
    """What processes share that can see each other's locks: one running system. A name isn't enough, as containers and
    clones of machines have the same."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:  # not Linux
        return platform.node()
