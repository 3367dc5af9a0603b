"""make-dataset: plans lenses as plain data, renders the photographs, writes the dataset, and verifies it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.datasets.format.dataset import Dataset
    from dofbench.datasets.synthesis.dataset_options import MakeDataset, MakeDatasets
    from dofbench.datasets.synthesis.verify import check_dataset


def make_dataset(settings: MakeDataset, *, progress: Progress | None = None) -> Path:
    """Make the dataset that `settings` describes and return its folder.

    The folder is as docs/datasets.md, "A dataset folder", lists it. A run that was killed continues where it stopped; a
    complete dataset of the same settings, scene and version isn't changed. progress: None shows the progress on
    standard error, and the folder on standard output. Raises InputError for wrong input, or when the folder has other
    content.
    """
    from dofbench.core.progress import Terminal
    from dofbench.datasets.synthesis.builder import make

    return make(settings, Terminal() if progress is None else progress)


def make_datasets(settings: MakeDatasets) -> bool:
    """Make all datasets that `settings` describe, several at a time, and print their folders; False if one failed.

    A single dataset is made in this process. Missing scenes of a named dataset are listed and skipped. Raises
    InputError before anything is made when a scene is unknown, and for a single dataset the errors of `make_dataset`.
    With `like`, also False when the new dataset isn't the same.
    """
    from dofbench.datasets.synthesis.several_datasets import make_all, planned
    from dofbench.runtime.executors import executor
    from dofbench.runtime.processes import LocalProcesses
    from dofbench.runtime.threads import available_cores

    if settings.like is not None:
        return _make_again(settings)
    datasets, missing = planned(settings)
    for scene in missing:
        print(f"skipped, because it is missing: {scene.label}: {scene.missing}", file=sys.stderr)
    if len(datasets) == 1 and settings.on == "here":
        make_dataset(datasets[0])
        return True
    workers = min(settings.jobs or available_cores(), len(datasets))
    by = executor(settings, settings.out or Path("data"), lambda: LocalProcesses(workers))
    outcomes = make_all(datasets, by)
    return not any(outcome.problem for outcome in outcomes)


def _make_again(settings: MakeDatasets) -> bool:
    from dofbench.core.progress import Terminal
    from dofbench.datasets.synthesis.remake import make_again

    different = make_again(settings, Terminal())
    if different:
        print(f"not the bytes of {settings.like}: {', '.join(different)}", file=sys.stderr)
    else:
        print(f"the same bytes as {settings.like}")
    return not different


def builtin_folder() -> Path:
    """The folder of the built-in dataset: data/<name> below the current folder."""
    from dofbench.datasets.synthesis.builder import BUILT_IN, default_folder

    return default_folder(BUILT_IN)


def __getattr__(name: str) -> Any:
    # These names load pydantic, numpy and more, so they are imported only when they are used.
    if name == "Dataset":
        from dofbench.datasets.format.dataset import Dataset

        return Dataset
    if name == "MakeDataset":
        from dofbench.datasets.synthesis.dataset_options import MakeDataset

        return MakeDataset
    if name == "check_dataset":
        from dofbench.datasets.synthesis.verify import check_dataset

        return check_dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["Dataset", "MakeDataset", "builtin_folder", "check_dataset", "make_dataset", "make_datasets"]
