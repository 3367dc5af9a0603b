"""Checks what a dataset's manifest says of its points, and triangulates points again that it says were triangulated."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.progress import Silent
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.schema import MANIFEST
from dofbench.datasets.synthesis.method_points import triangulated_between

_FILE = "sparse/0"
# Another machine, or another version of pycolmap, rounds otherwise, and so a few matches fall on the other side of a
# limit. Points from other photographs (of other views, or blurred otherwise) agree in few places to 0.1 % of their
# distance from the cameras.
_SAME_PLACE, _SAME_SHARE = 1e-3, 0.9


def check_points(dataset: Dataset) -> list[str]:
    """Problems of what the manifest says of the dataset's points, one line each; none for one that says nothing."""
    record = dataset.points_record
    if record is None:
        return []
    return [*_figures(dataset, record), *(_again(dataset, record) if record.origin == "triangulation" else [])]


def _figures(dataset: Dataset, record: PointsRecord) -> list[str]:
    points, given = dataset.points, dataset.training_points()
    known = points is not None and points.views is not None
    found = {
        "count": 0 if points is None else len(points),
        "given": 0 if given is None else len(given),
        "tracks": "known" if known else "unknown",
        "only_test_views": "left out" if known else "given",
    }
    problems = [
        f"{_FILE}: {name} of points is {value}, {getattr(record, name)} in {MANIFEST}"
        for name, value in found.items()
        if value != getattr(record, name)
    ]
    if record.views == "training" and points is not None:
        test = [index for index, view in enumerate(dataset.views) if view.split == "test"]
        seen = len(points.seen_by(test)) if known else len(points)
        if seen:
            problems.append(
                f"{_FILE}: {seen} points that a test view saw, expected none: {MANIFEST} says training views"
            )
    return problems


def _again(dataset: Dataset, record: PointsRecord) -> list[str]:
    if record.photographs != "sharp" and record.photographs != "shallow":
        return [f"{MANIFEST}: points triangulated between {record.photographs} photographs, expected sharp or shallow"]
    views = [(view.name, view.camera) for view in dataset.training_views()]
    narrow = dataset.photographer == "light-field"
    with tempfile.TemporaryDirectory() as work:
        place = Path(work) / "points"
        again = triangulated_between(dataset.folder, record.photographs, views, place, Silent(), narrow=narrow)
    share = _share_found(dataset.points, again, np.stack([camera.centre for _, camera in views]))
    if share < _SAME_SHARE:
        return [
            f"{_FILE}: {share:.0%} of the points triangulated again from the {record.photographs} training photographs "
            f"are where the dataset's are, expected at least {_SAME_SHARE:.0%}"
        ]
    return []


def _share_found(points: PointCloud | None, again: PointCloud | None, centres: np.ndarray) -> float:
    """Share of the larger of the two clouds that the other has in the same place, as seen from the cameras (N, 3)."""
    if points is None or again is None:
        return 0.0
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(again.xyz).query(points.xyz)
    away, _ = cKDTree(centres).query(points.xyz)
    return int((distance <= _SAME_PLACE * away).sum()) / max(len(points), len(again))
