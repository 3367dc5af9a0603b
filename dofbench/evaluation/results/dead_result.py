"""The result of a run whose process died for lack of memory, which its parent process writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dofbench.core.clock import timestamp
from dofbench.core.errors import Status
from dofbench.evaluation.results.result import RESULT_FILE, Result, write_result
from dofbench.evaluation.results.run_lease import run_lease

# What only the process itself could measure
_UNMEASURED = ("train_s", "train_cpu_s", "cold_start_s", "steps")


def record_out_of_memory(folder: Path, unfinished: dict[str, Any], why: str, peak_mb: float) -> str:
    """Write the result of the run that died in `folder`; returns one line about it.

    unfinished: the result as its process would have written it when the run began. why: one line. peak_mb: largest
    resident memory of the process, MB.

    Raises InputError when another process is at work on the run by now.
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
