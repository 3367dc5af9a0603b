"""The pictures that a run was scored against, and those that it made, if their checksums are still those in the
result."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.datasets.format.dataset import Dataset, DatasetView
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.scoring.evaluate import Kind
from dofbench.running.load_run import LoadedRun, loaded


def find_dataset(entries: Iterable[Entry]) -> tuple[Dataset | None, str]:
    """(the dataset that these runs of one board were scored on, "") or (None, why it can't be used)."""
    reason = "no run says where its dataset is"
    for run in filter(None, map(_loaded, entries)):
        try:
            return run.dataset, ""
        except InputError as error:
            reason = f"the dataset {run.result.spec.dataset} can't be used: {error}"
    return None, reason


def require_truth(dataset: Dataset, kind: Kind, view: DatasetView) -> None:
    """Raise InputError when the picture that predictions of this kind were compared with has changed since."""
    dataset.require_intact(view, "all_in_focus" if kind == "all_in_focus" else "image")


def true_picture(dataset: Dataset, kind: Kind, view: DatasetView) -> np.ndarray:
    """The picture that predictions of this kind were compared with, (H, W, 3), encoded. Raises InputError without
    one."""
    require_truth(dataset, kind, view)
    picture = dataset.all_in_focus(view) if kind == "all_in_focus" else dataset.image(view)
    if picture is None:
        raise InputError(f"view {view.name} of {dataset.name}", "no sharp photograph", "one to compare with")
    return picture


def prediction_file(entry: Entry, folder: str, view: str) -> Path | None:
    """The PNG of a prediction or of its error map, by folder below predictions/; None if it is missing, or its checksum
    isn't the one in the result."""
    run = _loaded(entry)
    try:
        return None if run is None else run.prediction(folder, view)
    except InputError:
        return None


def _loaded(entry: Entry) -> LoadedRun | None:
    return None if entry.result is None else loaded(entry.folder, entry.result)
