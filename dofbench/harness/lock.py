"""The lock on a result's folder: one process at a time, and a trace of one that died."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from dofbench.errors import InputError
from dofbench.files import read_json
from dofbench.harness.result import Spec

LOCK_FILE = "running.lock"


@contextmanager
def locked(folder: Path, spec: Spec, scene: str, started: str) -> Iterator[None]:
    """Hold the folder's lock, and say in its file what is being run.

    The system drops the lock with the process, however that ends; the file then stays behind, and
    says that a run died here. Raises InputError when another process holds the lock.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / LOCK_FILE
    with open(file, "a", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(folder, "another process at work on the same run", "to be alone") from None
        stream.truncate(0)
        json.dump({"process": os.getpid(), "started": started, "scene": scene, "spec": spec.model_dump()}, stream)
        stream.flush()
        try:
            yield
        finally:
            file.unlink(missing_ok=True)


def is_running(folder: Path) -> bool:
    """Whether a living process of this machine is writing the result in `folder`."""
    try:
        stream = open(folder / LOCK_FILE, "rb")
    except FileNotFoundError:
        return False
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def read_lock(folder: Path) -> tuple[Spec, str, str]:
    """(spec, scene, start time) of the run that died in `folder`. Raises InputError for a damaged file."""
    file = folder / LOCK_FILE
    data = read_json(file)
    try:
        return Spec.model_validate(data["spec"]), str(data["scene"]), str(data["started"])
    except (KeyError, TypeError, ValidationError):
        raise InputError(file, "no record of a run", "what `dofbench run` writes while it works") from None
