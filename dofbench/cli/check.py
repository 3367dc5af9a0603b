"""`dofbench check`: a dataset, a result, or every result below a folder."""

from __future__ import annotations

from enum import Enum
from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.progress import say
from dofbench.datasets.format.schema import MANIFEST, SIGNED, read_manifest
from dofbench.datasets.synthesis.verify import check_dataset
from dofbench.evaluation.results.result import RESULT_FILE, read_result
from dofbench.running.check_results import Checked, check_results, result_folders


class Verdict(Enum):
    """How a check ended. True where nothing is wrong and everything was checked."""

    GOOD = "good"
    NOT_RECOMPUTED = "scores not recomputed"
    WRONG = "wrong"

    def __bool__(self) -> bool:
        return self is Verdict.GOOD


def check(path: Path, console: Console | None = None, *, data: Path | None = None) -> Verdict:
    """Check a dataset, a result, or every result below a folder; print what is wrong, and what couldn't be checked.

    data: where the results' dataset is; None to look for it. For a folder of results, also reports runs that died and
    results that are stored twice. Raises InputError when there is neither a dataset nor a result at `path`.
    """
    console = console or Console()
    if not path.exists():
        raise InputError(path, "no such file or folder", "a dataset, a result or a folder of results")
    folder = path if path.is_dir() else path.parent

    tell = partial(say, console)

    if (folder / MANIFEST).is_file():
        if data is not None:
            raise InputError("--data", f"{data}, and {path} is a dataset itself", "results, whose dataset it is")
        found = {folder: Checked(check_dataset(folder))}
        if read_manifest(folder).version < SIGNED:
            tell(f"{folder}: {MANIFEST} is of an older version, without a digest of its own")
    elif folders := result_folders(folder):
        found = check_results(folders, tell, data)
    else:
        raise InputError(path, f"neither {MANIFEST} nor {RESULT_FILE}", "a dataset or a folder of results")
    for subject, checked in found.items():
        for line in checked.problems:
            tell(f"{subject}: {line}")
        if not checked.problems:
            why = checked.not_recomputed
            unsigned = (subject / RESULT_FILE).is_file() and read_result(subject).digest is None
            said = f"scores not recomputed ({why}); the rest is good" if why else "good"
            tell(f"{subject}: {said}{', of an older version without a digest of its own' if unsigned else ''}")
    if any(checked.problems for checked in found.values()):
        return Verdict.WRONG
    return Verdict.NOT_RECOMPUTED if any(checked.not_recomputed for checked in found.values()) else Verdict.GOOD
