"""The lock on a result's folder: one process at a time, and a trace of one that died."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from pydantic import ValidationError

from dofbench.core.errors import InputError
from dofbench.core.file_lock import taken
from dofbench.core.files import read_json
from dofbench.results.result import Spec

LOCK_FILE = "running.lock"
_GLANCE = 0.2  # seconds; who asks whether a run is at work (`is_running`) holds its lock for an instant


@contextmanager
def locked(folder: Path, spec: Spec, scene: str, started: str, *, wait: bool = False) -> Iterator[None]:
    """Hold the folder's lock, and say in its file what is being run.

    The system drops the lock with the process, however that ends; the file then stays behind, and
    says that a run died here. While another process holds the lock: waits, or raises InputError. Where
    there are no file locks nobody is kept out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / LOCK_FILE
    with _owned(file, wait) as stream:
        stream.truncate(0)
        json.dump({"process": os.getpid(), "started": started, "scene": scene, "spec": spec.model_dump()}, stream)
        stream.flush()
        try:
            yield
        finally:
            file.unlink(missing_ok=True)


def _owned(file: Path, wait: bool) -> TextIO:
    """The lock's file, open and locked. Its last owner may have removed it between our opening and our locking it:
    then a third process could lock a new one, so a lock counts only on the file that has the name still."""
    deadline = time.monotonic() + _GLANCE
    while True:
        stream = open(file, "a", encoding="utf-8")
        try:
            if taken(stream.fileno(), wait=wait):
                if os.path.samestat(os.fstat(stream.fileno()), os.stat(file)):
                    return stream
            elif time.monotonic() > deadline:
                raise InputError(file.parent, "another process at work on the same run", "to be alone")
            else:
                time.sleep(_GLANCE / 10)
        except FileNotFoundError:
            pass
        except BaseException:
            stream.close()
            raise
        stream.close()


def is_running(folder: Path) -> bool:
    """Whether a living process of this machine is writing the result in `folder`."""
    try:
        stream = open(folder / LOCK_FILE, "rb")
    except FileNotFoundError:
        return False
    with stream:
        return not taken(stream.fileno(), shared=True)


def read_lock(folder: Path) -> tuple[Spec, str, str]:
    """(spec, scene, start time) of the run that died in `folder`. Raises InputError for a damaged file."""
    file = folder / LOCK_FILE
    data = read_json(file)
    try:
        return Spec.model_validate(data["spec"]), str(data["scene"]), str(data["started"])
    except (KeyError, TypeError, ValidationError):
        raise InputError(file, "no record of a run", "what `dofbench run` writes while it works") from None
