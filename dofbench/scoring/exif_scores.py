"""Comparison of learned apertures with EXIF, and whether a dataset allows it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from dofbench.core.lens import PhysicalLens
from dofbench.dataset.benchmark_dataset import BenchmarkDataset
from dofbench.metrics.exif_errors import exif_errors
from dofbench.results.protocol import EXIF_COLUMNS
from dofbench.results.result import ViewAperture


def asked_by_exif(dataset: BenchmarkDataset, inputs: str) -> bool:
    """Whether apertures are to be compared with EXIF: the method trains on photographs of unknown lens."""
    train = dataset.training_views()
    return inputs == "shallow" and bool(train) and all(view.lens is None for view in train)


def missing_exif(dataset: BenchmarkDataset) -> str:
    """Why learned apertures can't be compared with EXIF, one line; "" if they can."""
    known = [
        view.exif
        for view in dataset.views
        if view.split == "train" and view.exif is not None and view.exif.f_number is not None
    ]
    if not known:
        return "no training photograph has an f-number in its EXIF"
    for name, values in (
        ("focal length", {exif.focal_length for exif in known}),
        ("camera", {exif.camera for exif in known}),
        ("lens", {exif.lens for exif in known}),
    ):
        if len(values - {None}) > 1:
            return f"more than one {name} took the training photographs"
    return ""


def learned_apertures(dataset: BenchmarkDataset, estimated: Mapping[str, PhysicalLens]) -> list[ViewAperture]:
    """The learned apertures of the training views with a known f-number, all transferred to the camera of the first of
    these views."""
    known = [
        (view, view.exif.f_number)
        for view in dataset.views
        if view.split == "train" and view.name in estimated and view.exif is not None and view.exif.f_number is not None
    ]
    return [
        ViewAperture(
            name=view.name,
            f_number=f_number,
            aperture=estimated[view.name].transferred(view.camera, known[0][0].camera).aperture,
        )
        for view, f_number in known
    ]


def exif_scores(apertures: Iterable[ViewAperture]) -> tuple[dict[str, float], dict[str, str]]:
    """(scores, reasons for missing scores), by column of `EXIF_COLUMNS`."""
    found = exif_errors([(view.aperture, view.f_number) for view in apertures])
    values = dict(zip(EXIF_COLUMNS, (found.spread, found.ratio), strict=True))
    reasons = dict(zip(EXIF_COLUMNS, (found.no_spread, found.no_ratio), strict=True))
    return (
        {column: value for column, value in values.items() if value is not None},
        {column: reasons[column] for column, value in values.items() if value is None},
    )
