"""A dataset's depth: maps, confidence, their record in the manifest, and the consistency between views."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.images import read_exr, read_image, to_8bit, write_exr, write_grey_png
from dofbench.core.lens import DisparityRange
from dofbench.core.names import inside
from dofbench.core.progress import Progress
from dofbench.datasets.format import layout
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.schema import ConsistencyRecord, DepthRecord, DepthViewRecord
from dofbench.datasets.synthesis import depth_sources
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.work import DEPTH_RECORD, WORK
from dofbench.runtime.view_threads import over_views, views_at_once
from dofbench.scenes.depth.disparity import scene_range
from dofbench.scenes.depth.multi_view import AGREEMENT, Consistency, consistencies, views_off
from dofbench.scenes.depth.source import DepthSource, SourceId
from dofbench.scenes.scene import Scene, SceneView

_VIEWS = "depth"  # folder in the work folder with the record of each finished view
# Floating-point results differ in their last digits between machines and with the alignment of memory, so the manifest
# rounds them. Shares of pixels often lie halfway between two rounded values; this factor moves them off the tie.
_UNTIED = 1 + 1e-9
_PREPARATION = {"splat": "reconstruction", "onnx": "network"}


def make_depth(
    scene: Scene,
    source_id: SourceId,
    network: Path | None,
    settings: MakeDataset,
    out: Path,
    progress: Progress,
    source: DepthSource | None = None,
    *,
    at_once: int = 1,
) -> tuple[DepthRecord, DisparityRange]:
    """Write depth and confidence of every view; returns their record and the disparity range of all views.

    source: where it is open already. at_once: views at a time. Files that an earlier run finished are kept. Raises
    InputError when the source can't give the depth, or no pixel is known.
    """
    kept = out / WORK / DEPTH_RECORD
    if kept.is_file() and all(_files_there(out, view) for view in scene.views):
        record = DepthRecord.model_validate(read_json(kept))
        if record.views:
            return record, _range(scene, out, at_once)
    steps = settings.depth_steps if source_id == "splat" else len(scene.views)
    opened = partial(
        depth_sources.open_source,
        source_id,
        scene,
        steps=settings.depth_steps,
        seed=settings.seed,
        work=out / WORK,
        network=network,
        at_once=at_once,
    )
    if source is None and source_id in _PREPARATION:
        with progress.stage(_PREPARATION[source_id], steps) as prepared:
            source = opened(progress=lambda done, _: prepared(done))
    elif source is None:
        source = opened()
    found = []
    with progress.stage("depth", len(scene.views)) as advance:
        # A plane sweep takes kilobytes a pixel for its costs, and OpenCV filters them on all cores.
        for one in over_views(partial(_one_view, source, out), scene.views, 1 if source.id == "sweep" else at_once):
            found.append(one)
            advance(len(found))
    disparity_range = _range(scene, out, at_once)
    with progress.stage("consistency", len(scene.views)) as advance:
        agreement = consistencies(
            [view.name for view in scene.views],
            [view.camera for view in scene.views],
            lambda index: read_exr(layout.depth_path(out, scene.views[index].name)),
            scene.points,
            disparity_range,
            advance,
            at_once=at_once,
        )
    record = DepthRecord(
        source=source.id,
        provenance=source.provenance(),
        confidence=source.confidence,
        views=tuple(
            one.model_copy(update={"consistency": _consistency_record(agrees)})
            for one, agrees in zip(found, agreement, strict=True)
        ),
    )
    write_json(kept, record.model_dump(mode="json"))
    return record, disparity_range


def check_depth(dataset: Dataset) -> list[str]:
    """Problems of a dataset's depth, one line each: views whose depth disagrees with their neighbours' or with their
    confidence.

    Computed from the maps, not read from the manifest, so that older datasets are checked too.
    """
    measured = [index for index, view in enumerate(dataset.views) if view.has_depth]
    names = [dataset.views[index].name for index in measured]
    at_once = views_at_once(max((view.camera.width * view.camera.height for view in dataset.views), default=0))
    problems = list(filter(None, over_views(partial(_odd_confidence, dataset), names, at_once)))
    found = _agreement(dataset, measured, at_once)
    usual = np.median([(one.difference, 1 - one.consistent) for one in found if one is not None] or [(0, 0)], axis=0)
    for index in views_off(found):
        one = found[index]
        assert one is not None
        problems.append(
            f"{layout.relative(layout.depth_path, names[index])}: disparity differs by {one.difference:.1%} "
            f"(median; signed {one.bias:+.1%}) from the neighbouring views', and by more than {AGREEMENT:.0%} in "
            f"{1 - one.consistent:.0%} of the pixels; {usual[0]:.1%} and {usual[1]:.0%} are usual here"
        )
    return problems


def _odd_confidence(dataset: Dataset, view: str) -> str | None:
    confidence, z = dataset.confidence(view), dataset.depth(view)
    if confidence is None:
        return None
    assert z is not None
    name = layout.relative(layout.confidence_path, view)
    if confidence.shape != z.shape:
        return f"{name}: shape {confidence.shape}, expected {z.shape}, as the depth"
    if (confidence[z <= 0] > 0).any():
        return f"{name}: {int((confidence[z <= 0] > 0).sum())} pixels of unknown depth with a confidence, expected 0"
    return None


def _agreement(dataset: Dataset, measured: Sequence[int], at_once: int) -> Sequence[Consistency | None]:
    """The consistency of the views that have depth; measured: their indices among the dataset's views."""
    if not measured:
        return []
    views = [dataset.views[index] for index in measured]
    assert dataset.disparity_range is not None

    def depth_of(index: int) -> np.ndarray:
        depth = dataset.depth(views[index])
        assert depth is not None
        return depth

    return consistencies(
        [view.name for view in views],
        [view.camera for view in views],
        depth_of,
        None if dataset.points is None else dataset.points.seen_by(measured),
        dataset.disparity_range,
        at_once=at_once,
    )


def _files_there(out: Path, view: SceneView) -> bool:
    return layout.depth_path(out, view.name).is_file() and layout.confidence_path(out, view.name).is_file()


def _one_view(source: DepthSource, out: Path, view: SceneView) -> DepthViewRecord:
    """Estimate a view's depth and write it, unless an earlier run has finished it; the record is written last."""
    noted = out / WORK / _VIEWS / f"{inside(view.name, 'view')}.json"
    if noted.is_file() and _files_there(out, view):
        return DepthViewRecord.model_validate(read_json(noted))
    estimate = source.estimate(view)
    # What stands under a mask is no part of the scene: its depth is unknown.
    depth = estimate.depth if view.mask is None else np.where(view.mask(), estimate.depth, np.float32(0))
    write_exr(layout.depth_path(out, view.name), depth)
    write_grey_png(layout.confidence_path(out, view.name), np.where(depth > 0, estimate.confidence, 0))
    record = record_of_files(out, view.name, estimate.statistics)
    write_json(noted, record.model_dump(mode="json"))
    return record


def record_of_files(root: Path, view: str, statistics: Mapping[str, float]) -> DepthViewRecord:
    """The manifest's record of a view's depth without its consistency, computed from the files in confidence/ and
    depth/.

    Sums are taken over integers, so that the same files give the same figures on every machine. statistics: from the
    depth source.
    """
    known = read_exr(layout.depth_path(root, view)) > 0
    levels = to_8bit(read_image(layout.confidence_path(root, view))[..., 0])[known]
    count = max(1, levels.size)
    return DepthViewRecord(
        view=view,
        known=levels.size / known.size,
        confidence=int(levels.sum(dtype=np.int64)) / (255 * count),
        confident=int(np.count_nonzero(levels > 127)) / count,
        statistics={name: _stated(value) for name, value in statistics.items()},
    )


def _stated(value: float) -> float:
    """The value, rounded to six digits unless it is a whole number."""
    return float(value) if float(value).is_integer() else float(f"{_UNTIED * value:.6g}")


def _consistency_record(found: Consistency | None) -> ConsistencyRecord | None:
    """The record, rounded to six decimals: small differences between views lose their leading digits by
    cancellation."""
    if found is None:
        return None
    figures = {name: round(_UNTIED * value, 6) + 0.0 for name, value in asdict(found).items() if name != "neighbours"}
    return ConsistencyRecord(neighbours=found.neighbours, **figures)


def _range(scene: Scene, out: Path, at_once: int) -> DisparityRange:
    def maps() -> Iterator[np.ndarray]:
        return over_views(lambda view: read_exr(layout.depth_path(out, view.name)), scene.views, at_once)

    try:
        return scene_range(maps)
    except ValueError:
        raise InputError(scene.root, "no pixel of known depth in any view", "depth to blur by") from None
