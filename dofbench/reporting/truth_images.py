"""The pictures that a run was scored against, and those that it made, if their checksums are still those in the
result."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.dataset.dataset import Dataset, DatasetView
from dofbench.results.collecting import Entry
from dofbench.scoring.evaluate import Kind


def find_dataset(entries: Iterable[Entry]) -> tuple[Dataset | None, str]:
    """(the dataset that these runs of one board were scored on, "") or (None, why it can't be used)."""
    reason = "no run says where its dataset is"
    for entry in entries:
        if entry.result is None:
            continue
        folder = Path(entry.result.data)
        if not (folder / "dataset.json").is_file():
            reason = f"the dataset {entry.spec.dataset} isn't where its results say"
            continue
        try:
            dataset = Dataset.load(folder)
        except InputError as error:
            reason = f"the dataset can't be read: {error}"
            continue
        if dataset.checksum == entry.spec.dataset_checksum:
            return dataset, ""
        reason = f"the dataset {entry.spec.dataset} is another one by now: its checksum isn't that of the results"
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
    if entry.result is None:
        return None
    relative = f"predictions/{folder}/{view}.png"
    path = entry.folder / relative
    known = entry.result.predictions.get(relative)
    return path if known is not None and path.is_file() and sha256_file(path) == known else None
