"""Where jobs are made: in processes of this machine, or on a cluster."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from dofbench.core.errors import InputError
from dofbench.core.jobs import Executor
from dofbench.core.options import options

_FOLDER = ".slurm"  # below the folder that the jobs write to


@options(kw_only=True)
class WhereOptions:
    """Options of commands that may have their jobs made elsewhere."""

    on: Literal["here", "slurm"] = "here"
    """Where the work is done: here, or as jobs of Slurm, which this command submits and watches (extra slurm). Ctrl-C
    leaves them there; the same command finds them again."""
    slurm: str = ""
    """Options of sbatch with --on slurm, by submitit's names: partition=gpu,account=me,cpus_per_task=8. Memory, time
    and a GPU follow from the work unless they are given here."""


def executor(settings: WhereOptions, folder: Path, here: Callable[[], Executor]) -> Executor:
    """The executor that the settings name. folder: what the jobs write to. here: makes that of this machine."""
    if settings.on == "here":
        if settings.slurm:
            raise InputError("--slurm", repr(settings.slurm), "nothing without --on slurm")
        return here()
    from dofbench.runtime.slurm import Slurm

    return Slurm(folder / _FOLDER, _parameters(settings.slurm))


def _parameters(text: str) -> dict[str, str | int]:
    found: dict[str, str | int] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, is_there, value = (word.strip() for word in part.partition("="))
        if not (name and is_there and value):
            raise InputError("--slurm", repr(part), "name=value, with commas between them")
        found[name.replace("-", "_")] = int(value) if value.isdigit() else value
    return found
