"""make-dataset: plan (plain data), render, write, verify; and the reader of what it writes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dofbench.core.progress import Progress
    from dofbench.dataset.dataset import Dataset
    from dofbench.synthesis.dataset_options import MakeDataset, MakeDatasets
    from dofbench.synthesis.verify import check_dataset


def make_dataset(settings: MakeDataset, *, progress: Progress | None = None) -> Path:
    """Make the dataset that `settings` describes and return its folder.

    The folder is as docs/datasets.md, "A dataset folder", lists it. A run that was killed goes on where it stopped; a
    complete dataset of the same settings, scene and version is left as it is. progress: None shows
    it on standard error, and the folder on standard output. Raises InputError for wrong input, or
    when the folder holds something else.
    """
    from dofbench.core.progress import Terminal
    from dofbench.synthesis.builder import make

    return make(settings, Terminal() if progress is None else progress)


def make_datasets(settings: MakeDatasets) -> bool:
    """Make all datasets that `settings` describe, several at a time, and say where they are; False if one failed.

    One dataset alone is made in this process. Scenes of a named dataset that aren't here are named and left out. Raises
    InputError before anything is made when a scene is unknown, and for one dataset as `make_dataset`. With `like`
    it is False too when the dataset doesn't come out the same.
    """
    from dofbench.compute.threads import available_cores
    from dofbench.synthesis.several_datasets import make_all, planned

    if settings.like is not None:
        return _make_again(settings)
    datasets, missing = planned(settings)
    for scene in missing:
        print(f"left out, as it isn't here: {scene.label}: {scene.missing}", file=sys.stderr)
    if len(datasets) == 1:
        make_dataset(datasets[0])
        return True
    outcomes = make_all(datasets, min(settings.jobs or available_cores(), len(datasets)))
    return not any(outcome.problem for outcome in outcomes)


def _make_again(settings: MakeDatasets) -> bool:
    from dofbench.core.progress import Terminal
    from dofbench.synthesis.remake import make_again

    different = make_again(settings, Terminal())
    if different:
        print(f"not the bytes of {settings.like}: {', '.join(different)}", file=sys.stderr)
    else:
        print(f"the same bytes as {settings.like}")
    return not different


def builtin_folder() -> Path:
    """Where `make_dataset()` of the built-in scene goes: data/<name>, below the current folder."""
    from dofbench.synthesis.builder import BUILT_IN, default_folder

    return default_folder(BUILT_IN)


def __getattr__(name: str) -> Any:
    # These bring pydantic, numpy and more: loaded only when asked for.
    if name == "Dataset":
        from dofbench.dataset.dataset import Dataset

        return Dataset
    if name == "MakeDataset":
        from dofbench.synthesis.dataset_options import MakeDataset

        return MakeDataset
    if name == "check_dataset":
        from dofbench.synthesis.verify import check_dataset

        return check_dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["Dataset", "MakeDataset", "builtin_folder", "check_dataset", "make_dataset", "make_datasets"]
