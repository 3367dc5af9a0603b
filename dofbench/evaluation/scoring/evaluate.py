"""Scores a method on a dataset's test views: quickly during training, fully at the end."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method, NonFinite, Rendering, RendersAhead
from dofbench.core.files import sha256_file
from dofbench.core.images import from_8bit, to_8bit, write_png
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.core.progress import Update, silent
from dofbench.core.similarity import unmasked
from dofbench.core.stored_image import StoredImage
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.evaluation.metrics import score_image
from dofbench.evaluation.metrics.depth_errors import disparity_error, relative_error
from dofbench.evaluation.metrics.lens_errors import do_nothing_errors, lens_errors
from dofbench.evaluation.results.protocol import (
    ACROSS_COLUMNS,
    ACROSS_PREFIX,
    AIF_PREFIX,
    BLUR_COLUMNS,
    DEPTH_COLUMNS,
    EVIDENCE_COLUMNS,
    EXIF_COLUMNS,
    EXIF_FOCUS_COLUMNS,
    FIT_CEILING,
    LENS_COLUMNS,
    OF_LENSES,
    PHOTO_PREFIX,
    WITHOUT_LENS,
    Protocol,
    arithmetic_mean,
)
from dofbench.evaluation.results.result import ViewAperture, ViewFit, ViewFocus, ViewLens, ViewScores
from dofbench.evaluation.scoring.error_maps import error_map
from dofbench.evaluation.scoring.exif_scores import exif_focus_scores, exif_scores, learned_apertures, learned_foci
from dofbench.evaluation.scoring.ground_truth import missing_truth
from dofbench.evaluation.scoring.photograph_scores import (
    NO_COVERAGE,
    NO_STRATA,
    NO_TEXTURE,
    Scored,
    ScoredPixels,
    fit_ceiling,
    fit_views,
    scored_photographs,
)
from dofbench.evaluation.scoring.photographs.lens_evidence import Seen, cannot_rank, energy_share, seen_share
from dofbench.evaluation.scoring.resolved import (
    RESOLVED_COLUMN,
    ResolvedCircles,
    photographs_of,
    resolved_map,
    resolved_share,
)

CURVE_METRICS = ("psnr", "ssim")  # cheap enough to be computed a dozen times during training
SPEED_VIEWS, SPEED_REPEATS = 8, 3  # test views rendered to measure the speed, and renderings of each

Item = TypeVar("Item")
Show = Callable[[str, str, np.ndarray], None]  # kind and view of a prediction, and its image
Kind = Literal["refocus", "all_in_focus", "photograph", "across"]
PREFIX: dict[Kind, str] = {
    "refocus": "",
    "all_in_focus": AIF_PREFIX,
    "photograph": PHOTO_PREFIX,
    "across": ACROSS_PREFIX,
}
# Why photographs lack a column; all others need strata.
_REASONS = {"photo_covered": NO_COVERAGE, **dict.fromkeys(BLUR_COLUMNS, NO_TEXTURE)}
# Kinds of prediction of which every pixel is scored, by any metric.
WHOLE: tuple[Kind, ...] = ("refocus", "all_in_focus")


@dataclass(eq=False)
class Evaluation:
    """The final scores: means by column, per-view values, fits, and sha256 of files by name. no_ranking: as in
    `Result`."""

    scores: dict[str, float] = field(default_factory=dict)
    views: list[ViewScores] = field(default_factory=list)
    lens: list[ViewLens] = field(default_factory=list)
    fits: list[ViewFit] = field(default_factory=list)
    apertures: list[ViewAperture] = field(default_factory=list)
    foci: list[ViewFocus] = field(default_factory=list)
    predictions: dict[str, str] = field(default_factory=dict)
    nonfinite: list[NonFinite] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    no_ranking: str = ""


class Evaluator:
    """Scores `method`, which may still be training, on the dataset's test views.

    columns: planned scores. left_out: reasons for scores that aren't planned.
    """

    def __init__(
        self,
        method: Method,
        dataset: BenchmarkDataset,
        protocol: Protocol,
        *,
        columns: Sequence[str],
        left_out: Mapping[str, str],
    ):
        self._method, self._dataset, self._protocol = method, dataset, protocol
        self._columns, self._left_out = columns, left_out
        self._test = dataset.test_views()
        self._train = dataset.training_views()
        self._truth: dict[tuple[Kind, str], StoredImage] = {}
        self._masks: dict[str, np.ndarray | None] = {}
        self._pixels = ScoredPixels(dataset)
        self._refused: str | None = None

    def quick(self, show: Show | None = None) -> dict[str, float]:
        """Mean PSNR and SSIM of the scored kinds of prediction, and lens errors, by column; of real photographs only a
        few, by a shorter search. show: called with the prediction of the first view of each kind."""
        self._ahead()
        scores: dict[str, float] = {}
        for kind in self._possible_kinds():
            metrics = [metric for metric in CURVE_METRICS if metric in self._metrics(kind)]
            rows: list[dict[str, float]] = []
            for view in self._test:
                image = self._predict(kind, view)
                if show is not None and not rows:
                    show(kind, view.name, image)
                rows.append(self._score(image, kind, view, metrics))
            scores |= _means(rows)
        if self._photographs():
            columns = [PREFIX[self._photograph_kind()] + metric for metric in CURVE_METRICS]
            rows = []
            for scored in self._scored_photographs(True):
                picture = scored.prediction.picture
                if show is not None and not rows and picture is not None:
                    show(self._photograph_kind(), scored.view.name, picture)
                # Other columns may be absent from some views.
                rows.append({column: scored.scores[column] for column in columns})
            scores |= _means(rows)
        errors, _ = self._lens_errors()
        return scores | errors

    def final(self, folder: Path, progress: Update = silent) -> Evaluation:
        """Score everything planned; write predictions and error maps to `folder`/predictions. progress: called for
        every scored image, since a real photograph takes seconds to minutes."""
        self._ahead()
        found = Evaluation()
        rows: dict[str, dict[str, float]] = {view.name: {} for view in self._test}
        kinds = self._possible_kinds()
        of_depth = any(column in self._columns for column in DEPTH_COLUMNS)
        # Photographs are a separate stage, because they take much longer than other images.
        energy: float | None = None
        if self._photographs():
            counted = _Counted(progress, "predict photographs", len(self._test))
            energy = self._score_photographs(folder, rows, found, counted)
        pictures = _Counted(progress, "score", (len(kinds) + of_depth + self._resolvable()) * len(self._test))
        if self._refused is not None:
            reason = f"the method refused to refocus: {self._refused}"
            found.left_out |= dict.fromkeys(self._protocol.refocus_columns, reason)
        for kind in kinds:
            for view in pictures.each(self._test):
                image = self._predict(kind, view)
                bad = int(image.size - np.count_nonzero(np.isfinite(image)))
                if bad:
                    detail = f"{bad} of {image.size} values of the prediction"
                    found.nonfinite.append(NonFinite(step=0, view=view.name, stage=f"render {kind}", detail=detail))
                    rows[view.name] |= {PREFIX[kind] + metric: math.nan for metric in self._metrics(kind)}
                    continue
                rows[view.name] |= self._score(image, kind, view, self._metrics(kind))
                self._write(folder, kind, view, image, found)
        if of_depth:
            for view in pictures.each(self._test):
                rows[view.name] |= self._depth_errors(view, found)
        circles = self._resolved(folder, rows, found, pictures)
        found.views = [ViewScores(name=name, scores=scores) for name, scores in rows.items()]
        found.scores = _means(list(rows.values()))
        if self._photographs():
            self._bounds(found, energy, circles, progress)
        self._score_by_exif(found)
        errors, found.lens = self._lens_errors()
        found.scores |= errors
        if not errors and any(column in self._columns for column in LENS_COLUMNS):
            found.left_out |= dict.fromkeys(LENS_COLUMNS, "the method gave no lens estimates")
        return found

    def _ahead(self) -> None:
        """Announce all views to a method that renders them together."""
        if not isinstance(self._method, RendersAhead):
            return
        trained = self._resolvable() or (self._photographs() and FIT_CEILING not in self._left_out)
        sharp = [*self._test, *(self._train if trained else ())]
        views: list[tuple[Camera, PhysicalLens | None]] = [(view.camera, None) for view in sharp]
        if self._metrics("refocus"):
            views += [(view.camera, view.physical_lens) for view in self._test]
        self._method.render_ahead(views)

    def _resolvable(self) -> bool:
        """Whether resolved surfaces can be computed."""
        return bool(self._test) and RESOLVED_COLUMN not in self._left_out and self._method.lens_estimates() is not None

    def _resolved(
        self, folder: Path, rows: dict[str, dict[str, float]], found: Evaluation, pictures: _Counted
    ) -> ResolvedCircles | None:
        """Score and map the share of each test view that the training views resolve; returns their circles, if any."""
        lenses = self._method.lens_estimates()
        if lenses is None or not self._resolvable():
            reason = "no test views" if not self._test else "the method has no learned lenses"
            found.left_out[RESOLVED_COLUMN] = self._left_out.get(RESOLVED_COLUMN, reason)
            return None
        photographs = photographs_of({view.name: view.camera for view in self._train}, lenses)
        circles = ResolvedCircles(self._method, photographs)
        for view in pictures.each(self._test):
            smallest = circles.smallest(view.camera)
            if (mask := self._mask(view)) is not None:
                smallest = np.where(mask, smallest, np.nan)
            rows[view.name][RESOLVED_COLUMN] = resolved_share(smallest)
            relative = f"predictions/resolved/{view.name}.png"
            write_png(folder / relative, resolved_map(smallest))
            found.predictions[relative] = sha256_file(folder / relative)
        return circles

    def _bounds(
        self, found: Evaluation, energy: float | None, circles: ResolvedCircles | None, progress: Update
    ) -> None:
        """The fit ceiling, and whether the dataset can rank lenses. energy: its share, None where no lens was tried."""
        views = () if FIT_CEILING in self._left_out else fit_views(self._dataset)
        counted = _Counted(progress, "predict training photographs", len(views))
        ceiling = fit_ceiling(self._method, self._dataset, counted.each(views), no_lens=self._no_lens())
        if ceiling is not None:
            found.scores[FIT_CEILING] = ceiling
        if energy is None or circles is None:
            found.left_out |= dict.fromkeys(EVIDENCE_COLUMNS, "no learned lens and depth to draw blur with")
            return
        lenses = self._method.lens_estimates() or {}
        masks = [self._mask(view) for view in self._train if view.name in lenses]
        seen = seen_share([Seen(*one, mask) for one, mask in zip(circles.seen, masks, strict=True)])
        found.scores |= dict(zip(EVIDENCE_COLUMNS, (energy, seen), strict=True))
        found.no_ranking = cannot_rank(energy, seen)

    def _score_by_exif(self, found: Evaluation) -> None:
        for columns in (EXIF_COLUMNS, EXIF_FOCUS_COLUMNS):
            if not any(column in self._columns for column in columns):
                continue
            estimated = self._method.lens_estimates()
            if estimated is None:
                found.left_out |= dict.fromkeys(columns, "the method gave no lens estimates")
                continue
            if columns == EXIF_COLUMNS:
                found.apertures = learned_apertures(self._dataset, estimated)
                scores, reasons = exif_scores(found.apertures)
            else:
                found.foci = learned_foci(self._dataset, estimated)
                scores, reasons = exif_focus_scores(found.foci)
            found.scores |= scores
            found.left_out |= reasons

    def do_nothing(self) -> dict[str, float]:
        """Lens errors of the constant prediction A = F = 0.5, by column; empty without lens errors or true lenses."""
        if not self._protocol.lens or missing_truth(self._dataset).lens:
            return {}
        errors = do_nothing_errors(self._true_lenses(), self._disparity_range(), self._widths(), self._depths())
        return {column: getattr(errors, column) for column in LENS_COLUMNS}

    def frames_per_second(self) -> float | None:
        """1 / median time of rendering a test view without a lens; None without test views.

        The first `SPEED_VIEWS` test views are rendered `SPEED_REPEATS` times, after one warm-up rendering.
        """
        cameras = [view.camera for view in self._test[:SPEED_VIEWS]]
        if not cameras:
            return None
        self._method.render(cameras[0], None)
        seconds = []
        for camera in cameras * SPEED_REPEATS:
            start = time.perf_counter()
            self._method.render(camera, None)
            seconds.append(time.perf_counter() - start)
        return 1.0 / max(statistics.median(seconds), time.get_clock_info("perf_counter").resolution)

    def _possible_kinds(self) -> list[Kind]:
        """The kinds of prediction to score; without refocusing if `Method.render` raises ValueError for a lens."""
        kinds: list[Kind] = [kind for kind in WHOLE if self._metrics(kind) and self._test]
        if "refocus" in kinds and self._refused is None:
            try:
                self._method.render(self._test[0].camera, self._test[0].physical_lens)
            except ValueError as error:
                self._refused = str(error)
        return [kind for kind in kinds if kind != "refocus" or self._refused is None]

    def _photographs(self) -> bool:
        return bool(self._test) and any(column in self._columns for column in self._protocol.photograph)

    def _photograph_kind(self) -> Kind:
        return "across" if self._protocol.photograph == ACROSS_COLUMNS else "photograph"

    def _scored_photographs(self, quick: bool) -> Iterator[Scored]:
        method, columns = self._method, self._protocol.photograph
        return scored_photographs(
            method, self._dataset, columns, no_lens=self._no_lens(), quick=quick, pixels=self._pixels
        )

    def _no_lens(self) -> str:
        """Why test views are predicted without a lens, as far as the plan knows."""
        return next((reason for column in OF_LENSES if (reason := self._left_out.get(column))), "")

    def _score_photographs(
        self, folder: Path, rows: dict[str, dict[str, float]], found: Evaluation, pictures: _Counted
    ) -> float | None:
        """Predict and score the test views that are real photographs of unknown lens; returns the share of the error
        energy that blur can explain, %, None where no lens was tried."""
        kind, refused, energies = self._photograph_kind(), "", list[tuple[float, float]]()
        for scored in pictures.each(self._scored_photographs(quick=False)):
            view, prediction = scored.view, scored.prediction
            rows[view.name] |= scored.scores
            found.fits.append(scored.fit)
            refused = refused or prediction.refused
            energies += [] if scored.energies is None else [scored.energies]
            if prediction.bad:
                detail = f"{prediction.bad} of {scored.photograph.size} values of the prediction"
                found.nonfinite.append(NonFinite(step=0, view=view.name, stage="render photograph", detail=detail))
            else:
                assert prediction.picture is not None
                self._write(folder, kind, view, prediction.picture, found)
        planned = [column for column in self._protocol.photograph if column in self._columns]
        for column in planned:
            if any(column not in scores for scores in rows.values()):
                reason = _REASONS.get(column, NO_STRATA)
                found.left_out[column] = f"{WITHOUT_LENS}: {refused}" if refused and column in OF_LENSES else reason
                for scores in rows.values():
                    scores.pop(column, None)
        return energy_share(energies) if len(energies) == len(rows) else None

    def _metrics(self, kind: Kind) -> list[str]:
        metrics = self._protocol.refocus if kind == "refocus" else self._protocol.all_in_focus
        return [metric for metric in metrics if PREFIX[kind] + metric in self._columns]

    def _depth_errors(self, view: BenchmarkView, found: Evaluation) -> dict[str, float]:
        depth, truth = np.asarray(self._rendered("all_in_focus", view).depth), true_depth(self._dataset, view)
        assert truth is not None
        if depth.shape != truth.shape:
            raise ValueError(f"render: expected depth of shape {truth.shape}, found {depth.shape}")
        bad = int(depth.size - np.count_nonzero(np.isfinite(depth)))
        if bad:
            detail = f"{bad} of {depth.size} values of the depth"
            found.nonfinite.append(NonFinite(step=0, view=view.name, stage="render depth", detail=detail))
            return dict.fromkeys(DEPTH_COLUMNS, math.nan)
        return depth_scores(depth, truth, self._disparity_range())

    def _rendered(self, kind: Kind, view: BenchmarkView) -> Rendering:
        return self._method.render(view.camera, view.physical_lens if kind == "refocus" else None)

    def _predict(self, kind: Kind, view: BenchmarkView) -> np.ndarray:
        """The rendering, (H, W, 3) float32, rounded to 8 bits if all values are finite."""
        image = np.asarray(self._rendered(kind, view).image)
        expected = (view.camera.height, view.camera.width, 3)
        if image.shape != expected:
            raise ValueError(f"render: expected an image of shape {expected}, found {image.shape}")
        return from_8bit(to_8bit(image)) if np.isfinite(image).all() else image

    def _score(self, image: np.ndarray, kind: Kind, view: BenchmarkView, metrics: list[str]) -> dict[str, float]:
        if not np.isfinite(image).all():
            return {PREFIX[kind] + metric: math.nan for metric in metrics}
        scores = score_image(image, self._true_image(kind, view), metrics, self._mask(view))
        return {PREFIX[kind] + metric: float(scores[metric]) for metric in metrics}

    def _true_image(self, kind: Kind, view: BenchmarkView) -> np.ndarray:
        key = kind, view.name
        if key not in self._truth:
            read = self._dataset.all_in_focus if kind == "all_in_focus" else self._dataset.image
            image = read(view)
            assert image is not None
            self._truth[key] = StoredImage.of(image)
        return self._truth[key].floats()

    def _mask(self, view: BenchmarkView) -> np.ndarray | None:
        if view.name not in self._masks:
            self._masks[view.name] = self._dataset.mask(view)
        return self._masks[view.name]

    def _write(self, folder: Path, kind: Kind, view: BenchmarkView, image: np.ndarray, found: Evaluation) -> None:
        picture = error_map(*unmasked(image, self._true_image(kind, view), self._mask(view)))
        for name, pixels in ((kind, image), (f"{kind}_error", picture)):
            relative = f"predictions/{name}/{view.name}.png"
            write_png(folder / relative, pixels)
            found.predictions[relative] = sha256_file(folder / relative)

    def _lens_errors(self) -> tuple[dict[str, float], list[ViewLens]]:
        """Means by column, and errors per view."""
        if not any(column in self._columns for column in LENS_COLUMNS):
            return {}, []
        estimated = self._method.lens_estimates()
        if estimated is None:
            return {}, []
        true, disparity_range = self._true_lenses(), self._disparity_range()
        errors = lens_errors(true, estimated, disparity_range, self._widths(), self._depths())
        views = []
        for name, lens in true.items():
            guess = Lens.from_physical(estimated[name], disparity_range)
            true_one = {"aperture": lens.aperture, "focus": lens.focus}
            found = {"aperture_estimated": guess.aperture, "focus_estimated": guess.focus}
            views.append(ViewLens(name=name, **true_one, **found, **errors.per_view[name]._asdict()))
        return {column: getattr(errors, column) for column in LENS_COLUMNS}, views

    def _true_lenses(self) -> dict[str, Lens]:
        lenses = {}
        for view in self._train:
            assert view.lens is not None
            lenses[view.name] = view.lens
        return lenses

    def _disparity_range(self) -> DisparityRange:
        """The unit of true lenses and depth errors; datasets with either have it."""
        found = self._dataset.disparity_range
        assert found is not None
        return found

    def _widths(self) -> dict[str, int]:
        return {view.name: view.camera.width for view in self._train}

    def _depths(self) -> dict[str, np.ndarray | None]:
        return {view.name: true_depth(self._dataset, view) for view in self._train}


class _Counted:
    """Update over `total` images in several loops."""

    def __init__(self, progress: Update, stage: str, total: int):
        self._progress, self._stage, self._total, self._done = progress, stage, total, 0
        if total:
            progress(stage, 0, total)

    def each(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items, counted."""
        for item in items:
            yield item
            self._done += 1
            self._progress(self._stage, self._done, self._total)


def true_depth(dataset: BenchmarkDataset, view: BenchmarkView) -> np.ndarray | None:
    """The view's depth, unknown (0) where it is masked; None if it has none."""
    depth, mask = dataset.depth(view), dataset.mask(view)
    return depth if depth is None or mask is None else np.where(mask, depth, np.float32(0))


def depth_scores(depth: np.ndarray, truth: np.ndarray, disparity_range: DisparityRange) -> dict[str, float]:
    """`DEPTH_COLUMNS` of a rendered depth map; both (H, W), scene units, 0 where empty or unknown."""
    errors = disparity_error(depth, truth, disparity_range), relative_error(depth, truth)
    return dict(zip(DEPTH_COLUMNS, errors, strict=True))


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each column over the views; NaN if a view's value is NaN."""
    columns = list(rows[0]) if rows else []
    return {column: arithmetic_mean([row[column] for row in rows]) for column in columns}
