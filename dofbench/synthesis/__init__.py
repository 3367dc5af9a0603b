"""make-dataset: plan (plain data), render, write, verify; and the reader of what it writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dofbench.synthesis.dataset import Dataset
    from dofbench.synthesis.progress import Progress
    from dofbench.synthesis.settings import MakeDataset
    from dofbench.synthesis.verify import check_dataset


def make_dataset(settings: MakeDataset, *, progress: Progress | None = None) -> Path:
    """Make the dataset that `settings` describes and return its folder.

    The folder is as conventions.md describes. A run that was killed goes on where it stopped; a
    complete dataset of the same settings, scene and version is left as it is. progress: None shows
    it on standard error, and the folder on standard output. Raises InputError for wrong input, or
    when the folder holds something else.
    """
    from dofbench.synthesis.make import make
    from dofbench.synthesis.progress import Terminal

    return make(settings, Terminal() if progress is None else progress)


def builtin_folder() -> Path:
    """Where `make_dataset()` of the built-in scene goes: data/<name>, below the current folder."""
    from dofbench.synthesis.make import BUILT_IN, default_folder

    return default_folder(BUILT_IN)


def __getattr__(name: str) -> Any:
    # These bring pydantic, numpy and more: loaded only when asked for.
    if name == "Dataset":
        from dofbench.synthesis.dataset import Dataset

        return Dataset
    if name == "MakeDataset":
        from dofbench.synthesis.settings import MakeDataset

        return MakeDataset
    if name == "check_dataset":
        from dofbench.synthesis.verify import check_dataset

        return check_dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["Dataset", "MakeDataset", "builtin_folder", "check_dataset", "make_dataset"]
