"""`dofbench check`: a dataset, a result, or every result below a folder."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.progress import say
from dofbench.dataset.schema import MANIFEST
from dofbench.results.result import RESULT_FILE
from dofbench.running.check_results import check_results, result_folders
from dofbench.synthesis.verify import check_dataset


def check(path: Path, console: Console | None = None) -> bool:
    """Check a dataset, a result, or every result below a folder; print what is wrong. True when nothing is wrong.

    For a folder of results, also reports runs that died and results that are stored twice. Raises InputError when there
    is neither a dataset nor a result at `path`.
    """
    console = console or Console()
    if not path.exists():
        raise InputError(path, "no such file or folder", "a dataset, a result or a folder of results")
    folder = path if path.is_dir() else path.parent

    tell = partial(say, console)

    if (folder / MANIFEST).is_file():
        problems = {folder: check_dataset(folder)}
    elif folders := result_folders(folder):
        problems = check_results(folders, tell)
    else:
        raise InputError(path, f"neither {MANIFEST} nor {RESULT_FILE}", "a dataset or a folder of results")
    for subject, lines in problems.items():
        for line in lines or ["good"]:
            tell(f"{subject}: {line}")
    return not any(problems.values())
