"""Scores of a result computed again from its dataset and the pictures and lenses that it kept, and compared.

Not computed again: what needs the trained model (depth errors, `resolved`, predictions without a lens and by the
unscaled aperture) or a user's weights (LPIPS), for which there is `dofbench score`, and what was measured once (times,
memory, speed).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from dofbench.core.errors import Status
from dofbench.core.images import read_image
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.datasets.format.dataset import Dataset, DatasetView
from dofbench.evaluation.metrics import METRICS, score_image
from dofbench.evaluation.metrics.lens_errors import do_nothing_errors, lens_errors
from dofbench.evaluation.results.added_scores import read_added
from dofbench.evaluation.results.protocol import ACROSS_COLUMNS, BLUR_COLUMNS, LENS_COLUMNS, scores_both_halves
from dofbench.evaluation.results.result import Result
from dofbench.evaluation.scoring.evaluate import CURVE_METRICS, PREFIX, WHOLE, Kind, true_depth
from dofbench.evaluation.scoring.photograph_scores import (
    BLURRED,
    CLEAR,
    ScoredPixels,
    blurred_thirds,
    picture_blur,
    picture_scores,
)
from dofbench.evaluation.scoring.photographs.image_tiles import masked_psnr
from dofbench.running.load_run import LoadedRun

# The pictures hold exactly what was scored (8 bits), so only the order of summation may differ.
PSNR_AGREEMENT = 1e-4  # dB
AGREEMENT = 1e-6  # relative, or absolute for smaller scores, of all others
# The end of the curve was scored before the model was saved and read back, which may move a pixel by one level.
CURVE_AGREEMENT = 0.02  # dB of PSNR; a hundredth of it of SSIM and of lens errors


def differences(run: LoadedRun) -> list[str]:
    """One line for each score that doesn't come out again, or belongs to a view that the dataset doesn't have so.

    Raises InputError when the dataset isn't there, isn't the result's, or has changed files.
    """
    result, dataset = run.result, run.dataset
    return [
        *_standing(result, dataset),
        *_images(run, dataset),
        *_lenses(result, dataset),
        *_f_numbers(result, dataset),
        *_curve(result),
    ]


def _standing(result: Result, dataset: Dataset) -> Iterator[str]:
    """The scene, the role and the photographer are the dataset's; results of older versions state neither of the last
    two."""
    pairs: list[tuple[str, str | None, str | None]] = [("scene", result.scene, dataset.scene)]
    if result.photographer is not None:
        pairs += [("role", result.role, dataset.role), ("photographer", result.photographer, dataset.photographer)]
    yield from (f"{name} {own}, and {whole} of {dataset.folder}" for name, own, whole in pairs if own != whole)


def _images(run: LoadedRun, dataset: Dataset) -> Iterator[str]:
    test = {view.name: view for view in dataset.test_views()}
    pixels = ScoredPixels(dataset, both=scores_both_halves(run.result.spec.protocol))
    thirds: dict[str, np.ndarray] | None = None
    added = read_added(run.folder)
    for scored in run.result.views:
        if scored.name not in test:
            yield f"view {scored.name}: not a test view of {run.data}"
            continue
        later = added.scores.items() if added else ()
        stored = {
            **scored.scores,
            **{column: score.views[scored.name] for column, score in later if scored.name in score.views},
        }
        if thirds is None and any(column in stored for column in _STRATA):
            thirds = blurred_thirds(dataset, pixels)
        again = _scores_again(run, dataset, test[scored.name], stored, pixels, thirds or {})
        for column, value in again.items():
            if not _agrees(column, stored[column], value):
                yield f"view {scored.name}: {column} is {stored[column]:.6g}, computed again {value:.6g}"
    left = sorted(test.keys() - {view.name for view in run.result.views})
    if left and run.result.status is Status.OK and run.result.views:
        yield f"view {left[0]}: a test view of {run.data}, and no scores of it ({len(left)} are missing)"


_STRATA = {"across_blurred_psnr": BLURRED, "across_clear_psnr": CLEAR}


def _scores_again(
    run: LoadedRun,
    dataset: Dataset,
    view: DatasetView,
    stored: dict[str, float],
    pixels: ScoredPixels,
    thirds: dict[str, np.ndarray],
) -> dict[str, float]:
    """Column -> value, of the view's stored columns that its kept pictures give."""
    again: dict[str, float] = {}
    for kind, prefix in PREFIX.items():
        own = [column for column in stored if _kind(column) == kind and not math.isnan(stored[column])]
        if not own:
            continue
        truth = (dataset.all_in_focus if kind == "all_in_focus" else dataset.image)(view)
        assert truth is not None
        picture = read_image(run.prediction(kind, view.name))
        if kind in WHOLE:
            scores = score_image(picture, truth, [column.removeprefix(prefix) for column in own], dataset.mask(view))
            again |= {prefix + metric: float(value) for metric, value in scores.items()}
            continue
        scores = picture_scores(picture, truth, prefix, pixels.tiles(view))
        if kind == "photograph" and not {*BLUR_COLUMNS}.isdisjoint(own):
            scores |= picture_blur(picture, truth, pixels.tiles(view))
        if view.name in thirds:
            scores |= {column: masked_psnr(picture, truth, thirds[view.name] == of) for column, of in _STRATA.items()}
        again |= {column: value for column, value in scores.items() if column in own}
    if "photo_covered" in stored:
        again["photo_covered"] = pixels.of(view)[1] or 0.0
    return again


def _kind(column: str) -> Kind | None:
    """The kind of kept picture that a column is a score of; None for any other column."""
    if column in ("photo_psnr", "photo_ssim", "photo_blur", "photo_blur_bias"):
        return "photograph"
    if column in ACROSS_COLUMNS:
        return "across" if column.startswith(PREFIX["across"]) else None
    for kind in ("all_in_focus", "refocus"):
        metric = METRICS.get(column.removeprefix(PREFIX[kind])) if column.startswith(PREFIX[kind]) else None
        if metric is not None and metric.needs == "images":
            return kind
    return None


def _lenses(result: Result, dataset: Dataset) -> Iterator[str]:
    train, disparity_range = dataset.training_views(), dataset.disparity_range
    true = {view.name: view.lens for view in train if view.lens is not None}
    if not (result.lens or result.do_nothing) or disparity_range is None:
        return
    if len(true) < len(train) or (result.lens and sorted(view.name for view in result.lens) != sorted(true)):
        yield f"lens errors of other views than the {len(true)} training views of known lens of {dataset.folder}"
        return
    for view in result.lens:
        if (view.aperture, view.focus) != (true[view.name].aperture, true[view.name].focus):
            yield f"view {view.name}: another true lens than that of {dataset.folder}"
    width, depths = train[0].camera.width, {view.name: true_depth(dataset, view) for view in train}
    if result.do_nothing:
        nothing = do_nothing_errors(true, disparity_range, width, depths)
        for column in LENS_COLUMNS:
            yield from _differing(f"do_nothing {column}", result.do_nothing.get(column), getattr(nothing, column))
    if not result.lens:
        return
    estimated = {view.name: _estimate(view.aperture_estimated, view.focus_estimated, disparity_range, width)
                 for view in result.lens}  # fmt: skip
    errors = lens_errors(true, estimated, disparity_range, width, depths)
    for view in result.lens:
        for column in LENS_COLUMNS:
            again = getattr(errors.per_view[view.name], column)
            yield from _differing(f"view {view.name}: {column}", getattr(view, column), again)
    for column in LENS_COLUMNS:
        yield from _differing(column, result.scores.get(column), getattr(errors, column))


def _estimate(aperture: float, focus: float, disparity_range: DisparityRange, width: int) -> PhysicalLens:
    return Lens(aperture, focus).physical(disparity_range, width)


def _f_numbers(result: Result, dataset: Dataset) -> Iterator[str]:
    exif = {view.name: view.exif for view in dataset.training_views()}
    for view in result.apertures:
        record = exif.get(view.name)
        if record is None or record.f_number != view.f_number:
            yield f"view {view.name}: f/{view.f_number:g}, which its EXIF in {dataset.folder} doesn't say"


def _curve(result: Result) -> Iterator[str]:
    """The curve's last point scored the model that the result's own scores are of. Older code may have scored the two
    otherwise."""
    if (
        result.digest is None
        or result.status is not Status.OK
        or not result.curve
        or any(view.scores.get("photo_psnr") for view in result.views)
    ):
        return
    last = result.curve[-1].scores
    for kind in WHOLE:
        for metric in CURVE_METRICS:
            column = PREFIX[kind] + metric
            bound = CURVE_AGREEMENT if metric == "psnr" else CURVE_AGREEMENT / 100
            if column in last and column in result.scores and not abs(last[column] - result.scores[column]) <= bound:
                yield f"{column} is {result.scores[column]:.6g}, and {last[column]:.6g} at the end of the curve"
    for column in LENS_COLUMNS:
        if column in last and column in result.scores:
            stored = result.scores[column]
            if not math.isclose(last[column], stored, rel_tol=CURVE_AGREEMENT / 100, abs_tol=CURVE_AGREEMENT / 100):
                yield f"{column} is {stored:.6g}, and {last[column]:.6g} at the end of the curve"


def _differing(what: str, stored: float | None, again: float) -> Iterator[str]:
    if stored is None or not _agrees("", stored, again):
        yield f"{what} is {'absent' if stored is None else f'{stored:.6g}'}, computed again {again:.6g}"


def _agrees(column: str, stored: float, again: float) -> bool:
    if stored == again or (math.isnan(stored) and math.isnan(again)):
        return True
    if column.endswith("psnr"):
        return abs(again - stored) <= PSNR_AGREEMENT
    return math.isclose(stored, again, rel_tol=AGREEMENT, abs_tol=AGREEMENT)
