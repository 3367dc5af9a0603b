"""The lease on a result's folder: one process at a time on any machine, and a record of a process that died."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dofbench.core.clock import timestamp
from dofbench.core.errors import InputError, Status
from dofbench.evaluation.results.result import RESULT_FILE, Result, Spec, write_result
from dofbench.runtime.leases import Lease, leased, left_note

_UNMEASURED = ("train_s", "train_cpu_s", "cold_start_s", "steps")  # only the process itself could measure these


@contextmanager
def run_lease(folder: Path, spec: Spec, scene: str, started: str, *, wait: bool = False) -> Iterator[Lease]:
    """Hold the folder's lease, with a record of the run in its file, which stays if the process dies.

    While another process holds the lease, wait, or raise InputError.
    """
    note = {"started": started, "scene": scene, "spec": spec.model_dump()}
    with leased(folder, note, wait=wait) as lease:
        yield lease


def read_lease(folder: Path) -> tuple[Spec, str, str] | None:
    """(spec, scene, start time) of the run whose lease is in `folder`, or None. Raises InputError for a damaged
    file."""
    found = left_note(folder)
    if found is None:
        return None
    file, note = found
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
    with run_lease(folder, result.spec, result.scene, result.started):
        write_result(folder, result)
    return f"{result.spec.folder}: {result.status}, {why}; result {folder / RESULT_FILE}"
