"""The lock on a result's folder: one process at a time, and in its file a record of a run whose process died."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dofbench.core.clock import timestamp
from dofbench.core.errors import InputError, Status
from dofbench.core.file_lock import is_locked, locked
from dofbench.core.files import files_below, read_json
from dofbench.evaluation.results.result import RESULT_FILE, Result, Spec, write_result

LOCK_FILE = "running.lock"
_UNMEASURED = ("train_s", "train_cpu_s", "cold_start_s", "steps")  # only the process itself could measure these


@contextmanager
def run_lock(folder: Path, spec: Spec, scene: str, started: str) -> Iterator[None]:
    """Hold the folder's lock. Its file has a record of the run, and stays if the process dies.

    Raises HeldElsewhere, an InputError, while another process holds it.
    """
    with locked(folder / LOCK_FILE, "another process at work on the same run", "to be alone"):
        # In place: another file of that name would be without the lock.
        (folder / LOCK_FILE).write_text(
            json.dumps({"started": started, "scene": scene, "spec": spec.model_dump()}), encoding="utf-8"
        )
        yield


def at_work(folder: Path) -> bool:
    """Whether a living process has a run in this folder at work."""
    return is_locked(folder / LOCK_FILE)


def begun_folders(root: Path) -> list[Path]:
    """Folders at or below `root` with a run that is at work, or whose process died."""
    return sorted(file.parent for file in files_below(root, LOCK_FILE))


def read_lock(folder: Path) -> tuple[Spec, str, str] | None:
    """(spec, scene, start time) of the run that the lock's file in `folder` records, or None. Raises InputError for a
    damaged file."""
    file = folder / LOCK_FILE
    if not file.is_file() or not file.stat().st_size:
        return None
    note = read_json(file)
    try:
        return Spec.model_validate(note["spec"]), str(note["scene"]), str(note["started"])
    except (KeyError, TypeError, ValidationError):
        raise InputError(file, "no record of a run", "what `dofbench run` writes while it works") from None


def record_out_of_memory(folder: Path, unfinished: dict[str, Any], why: str, peak_mb: float) -> str:
    """Write the result of a run that died for lack of memory in `folder`; returns one line about it.

    unfinished: the result at the start of the run. why: one line. peak_mb: largest resident memory, MB. Raises
    InputError if another process is at work on the run.
    """
    result = Result.model_validate(unfinished)
    result = result.model_copy(
        update={
            "status": Status.OUT_OF_MEMORY,
            "message": why,
            "ended": timestamp(),
            "scores": {"peak_mb": peak_mb},
            "left_out": result.left_out | dict.fromkeys(_UNMEASURED, "the process died"),
        }
    )
    with run_lock(folder, result.spec, result.scene, result.started):
        write_result(folder, result)
    return f"{result.spec.folder}: {result.status}, {why}; result {folder / RESULT_FILE}"
