"""The lease on a result's folder: one process at a time, on whatever machine, and a trace of one that died."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from dofbench.core.errors import InputError
from dofbench.core.leases import Lease, at_work, leased, left_note
from dofbench.results.result import Spec


@contextmanager
def run_lease(folder: Path, spec: Spec, scene: str, started: str, *, wait: bool = False) -> Iterator[Lease]:
    """Hold the folder's lease, and say in its file what is being run.

    When the process dies the file stays behind, and says that a run died here. While another process has it: waits, or
    raises InputError.
    """
    note = {"started": started, "scene": scene, "spec": spec.model_dump()}
    with leased(folder, note, wait=wait) as lease:
        yield lease


def is_running(folder: Path) -> bool:
    """Whether a living process is writing the result in `folder`."""
    return at_work(folder)


def read_lease(folder: Path) -> tuple[Spec, str, str] | None:
    """(spec, scene, start time) of the run whose lease lies in `folder`; None where there is none.

    Raises InputError for a damaged file.
    """
    found = left_note(folder)
    if found is None:
        return None
    file, note = found
    try:
        return Spec.model_validate(note["spec"]), str(note["scene"]), str(note["started"])
    except (KeyError, TypeError, ValidationError):
        raise InputError(file, "no record of a run", "what `dofbench run` writes while it works") from None
