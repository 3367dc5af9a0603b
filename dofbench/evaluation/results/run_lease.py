"""The lease on a result's folder, which admits one process at a time on any machine, and shows if a process died."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from dofbench.core.errors import InputError
from dofbench.evaluation.results.result import Spec
from dofbench.runtime.leases import Lease, leased, left_note


@contextmanager
def run_lease(folder: Path, spec: Spec, scene: str, started: str, *, wait: bool = False) -> Iterator[Lease]:
    """Hold the folder's lease, and record in its file which run is in progress.

    If the process dies, the file stays and shows that a run died here. While another process holds the lease, this
    waits, or raises InputError.
    """
    note = {"started": started, "scene": scene, "spec": spec.model_dump()}
    with leased(folder, note, wait=wait) as lease:
        yield lease


def read_lease(folder: Path) -> tuple[Spec, str, str] | None:
    """(spec, scene, start time) of the run whose lease is in `folder`; None without a lease.

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
