"""`dofbench run`: make the built-in dataset, if no dataset is given and it doesn't exist yet, then run."""

from __future__ import annotations

from rich.console import Console

from dofbench.cli.run_photographs import run_photographs
from dofbench.core.jobs import Executor
from dofbench.core.progress import say
from dofbench.datasets.format.schema import MANIFEST
from dofbench.datasets.synthesis import builtin_folder, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.running.matrix import run_all
from dofbench.running.prepare import choose
from dofbench.running.run_options import Runs


def run_methods(settings: Runs, console: Console | None = None, executor: Executor | None = None) -> bool:
    """Carry out the runs that the settings name; False when a run failed.

    Raises InputError when the call is wrong, before anything is made or run.
    """
    console = console or Console()
    if settings.photographs is not None:
        return run_photographs(settings, settings.photographs, console, executor)
    if settings.data is None and not (builtin_folder() / MANIFEST).is_file():
        for cell in settings.cells():
            choose(cell)  # a wrong call ends here, not after the dataset was made
        if settings.dry_run:
            say(console, f"would first make the built-in dataset in {builtin_folder()}; the plan depends on it")
            return True
        say(console, f"making the built-in dataset in {builtin_folder()}")
        make_dataset(MakeDataset(out=builtin_folder()))
    return run_all(settings, builtin_folder(), console, executor)
