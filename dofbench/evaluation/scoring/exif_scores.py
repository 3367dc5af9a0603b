"""Learned apertures and foci compared with EXIF, and whether a dataset allows it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from dofbench.core.lens import PhysicalLens
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset
from dofbench.evaluation.metrics.exif_errors import exif_errors, exif_focus_errors, too_few_distances
from dofbench.evaluation.results.protocol import EXIF_COLUMNS, EXIF_FOCUS_COLUMNS
from dofbench.evaluation.results.result import ViewAperture, ViewFocus


def asked_by_exif(dataset: BenchmarkDataset, inputs: str) -> bool:
    """Whether lenses are compared with EXIF: the method trains on real photographs of unknown lens."""
    train = dataset.training_views()
    return inputs == "shallow" and bool(train) and all(view.lens is None for view in train)


def missing_exif(dataset: BenchmarkDataset) -> str:
    """Why learned apertures can't be compared with EXIF, one line; "" if they can.

    Of photographs smaller than their own size they aren't: blur of less than a pixel tells no apertures apart.
    """
    known = [
        view.exif
        for view in dataset.views
        if view.split == "train" and view.exif is not None and view.exif.f_number is not None
    ]
    if not known:
        return "no training view has an f-number in its EXIF"
    for name, values in (
        ("focal length", {exif.focal_length for exif in known}),
        ("camera", {exif.camera for exif in known}),
        ("lens", {exif.lens for exif in known}),
    ):
        if len(values - {None}) > 1:
            return f"the training views have more than one {name}"
    if dataset.full_size is None:
        return "the dataset doesn't state whether its photographs have their own size: make it again"
    return "" if dataset.full_size else "the photographs are smaller than their own size"


def learned_apertures(dataset: BenchmarkDataset, estimated: Mapping[str, PhysicalLens]) -> list[ViewAperture]:
    """The learned apertures of the training views with a known f-number, transferred to the first one's camera."""
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


def missing_exif_focus(dataset: BenchmarkDataset) -> str:
    """Why learned foci can't be compared with EXIF, one line; "" if they can."""
    return too_few_distances(
        [
            view.exif.focus_distance
            for view in dataset.training_views()
            if view.exif is not None and view.exif.focus_distance is not None
        ]
    )


def learned_foci(dataset: BenchmarkDataset, estimated: Mapping[str, PhysicalLens]) -> list[ViewFocus]:
    """The learned foci of the training views whose EXIF has a focus distance."""
    return [
        ViewFocus(
            name=view.name, focus_disparity=estimated[view.name].focus_disparity, distance=view.exif.focus_distance
        )
        for view in dataset.training_views()
        if view.name in estimated and view.exif is not None and view.exif.focus_distance is not None
    ]


def exif_focus_scores(foci: Iterable[ViewFocus]) -> tuple[dict[str, float], dict[str, str]]:
    """Scores and reasons for missing scores, by column of `EXIF_FOCUS_COLUMNS`."""
    found = exif_focus_errors([(view.focus_disparity, view.distance) for view in foci])
    return _by_column(EXIF_FOCUS_COLUMNS, (found.rank, found.scatter), (found.reason, found.no_scatter))


def exif_scores(apertures: Iterable[ViewAperture]) -> tuple[dict[str, float], dict[str, str]]:
    """Scores and reasons for missing scores, by column of `EXIF_COLUMNS`."""
    found = exif_errors([(view.aperture, view.f_number) for view in apertures])
    return _by_column(EXIF_COLUMNS, (found.spread, found.ratio), (found.no_spread, found.no_ratio))


def _by_column(
    columns: tuple[str, ...], values: tuple[float | None, ...], reasons: tuple[str, ...]
) -> tuple[dict[str, float], dict[str, str]]:
    known = zip(columns, values, strict=True)
    scores = {column: value for column, value in known if value is not None}
    missing = zip(columns, reasons, strict=True)
    return scores, {column: reason for column, reason in missing if column not in scores}
