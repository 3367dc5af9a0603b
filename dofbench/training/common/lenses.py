"""The learnable lens of every training view (DoF-Gaussian, section 4.1), and what views share of it.

A lens of focal length f at f-number N has an opening f / N wide, and its CoCs in pixels grow with the focal length in
pixels. So views that were taken together may share their aperture (px x scene unit), up to a factor that EXIF states,
while each has its own focus. Where cameras differ, as in portrait and landscape, the factor of the focal length in
image widths is part of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.contracts import TrainingView
from dofbench.core.errors import InputError
from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens, framing
from dofbench.training.common.depth import rendered_range
from dofbench.training.common.row_adam import RowAdam, step_together

LensPer = Literal["view", "aperture", "group", "exif", "scene"]


@dataclass(frozen=True)
class Ties:
    """aperture, focus: index of each view's aperture and focus, which views of equal index share. opening: the factor
    from the shared aperture to each view's own."""

    aperture: tuple[int, ...]
    focus: tuple[int, ...]
    opening: tuple[float, ...]

    @property
    def tied(self) -> bool:
        """Whether some views share an aperture but not their focus."""
        return max(self.aperture) != max(self.focus)

    @staticmethod
    def untied(count: int) -> Ties:
        """Ties of `count` views that share nothing."""
        every = tuple(range(count))
        return Ties(every, every, (1.0,) * count)


def lens_ties(views: Sequence[TrainingView], per: LensPer) -> Ties:
    """The ties of the views. per: see option `lens_per`. Raises InputError for "group" and "exif" without f-numbers."""
    count = len(views)
    each, one = tuple(range(count)), (0,) * count
    if per == "view":
        return Ties.untied(count)
    # CoC radii are learned in units of the image's width.
    openings = np.array([framing(view.camera) for view in views])
    if per == "scene":
        return Ties(one, one, _about_median(openings))
    numbers = [None if view.exif is None else view.exif.f_number for view in views]
    known = [number for number in numbers if number is not None]
    if per != "aperture" and len(known) < count:
        name = views[numbers.index(None)].name
        raise InputError(
            "option lens_per",
            f"{per}, and view {name} without an f-number",
            "EXIF with the f-number of every photograph, or lens_per=aperture",
        )
    if per == "exif":
        lengths = [None if view.exif is None else view.exif.focal_length for view in views]
        openings = openings * np.array([1.0 if length is None else length for length in lengths]) / np.array(known)
    different = sorted(set(known))
    shared = tuple(different.index(number) for number in known) if per == "group" else one
    return Ties(shared, each, _about_median(openings))


def _about_median(openings: np.ndarray) -> tuple[float, ...]:
    return tuple(float(opening) for opening in openings / np.median(openings))


_FLOOR = 1e-5  # least aperture; the released code adds it after the relu


@dataclass(frozen=True)
class LensOptions:
    """How a lens is parameterised, what photographs share of it, its initial value and its learning rate."""

    lens: bool = True
    """Whether there is a lens; without one a pinhole is trained. Unit: none. Source: section 4.1."""
    lens_range: Literal["points", "render"] = "points"
    """The disparities that 0 and 1 stand for: points, fixed once by the sparse points; render, minimum and 95th
    percentile of each rendered view at each step. Unit: none. Source: points: own; render: released code."""
    lens_clip: bool = False
    """Whether the disparities of a photograph in training are clipped to 1e-5 to 1 when they are normalised. Unit:
    none. Source: on: released code; off: Eq. 5."""
    lens_per: LensPer = "view"
    """What photographs share of a lens: view, nothing; aperture, one aperture, with a focus each; group, one aperture
    for each f-number; exif, one aperture x f-number; scene, the whole lens. Unit: none. Source: view: section 4.1;
    others: own."""
    lens_activation: Literal["relu", "log", "ends"] = "relu"
    """What is learned: relu, aperture and focus above 0; log, the aperture's logarithm and the focus; ends, the signed
    circles of confusion at disparity 0 and 1. Unit: none. Source: relu: released code; others: own."""
    lens_update: Literal["view", "dense"] = "view"
    """Whose moments Adam updates at a step: view, those of the view's lens; dense, those of all lenses. Unit: none.
    Source: view: own; dense: released code."""
    lens_lr: float = 5e-4
    """Adam's learning rate of the lens's parameters at the start. Unit: parameter, a step. Source: released code."""
    lens_lr_final: float = 5e-4
    """The learning rate at the end; it falls exponentially in between. Unit: parameter, a step. Source: released
    code."""
    lens_from: float = 0.0
    """When learning the lens begins; before, it keeps its initial value. Unit: share of the training. Source: released
    code."""
    lens_init_aperture: float = 0.5
    """Aperture that every lens starts from; 1 is a circle of 2 % of the width per unit of normalised disparity.
    Unit: normalised. Source: released code."""
    lens_init_focus: float = 0.5
    """Focus that every lens starts from, 0 far to 1 near. Unit: normalised disparity. Source: released code."""
    lens_focus_from: Literal["option", "exif"] = "option"
    """Where foci start: option, at lens_init_focus; exif, in the ratios of the disparities in focus that EXIF states,
    their median at lens_init_focus. Unit: none. Source: own."""
    lens_free_until: float = 0.0
    """Until when training has no lens. Unit: share of the training. Source: own."""
    lens_measured_at: float = 1.0
    """When lenses are measured by the blur of photographs of one surface, and set to it; 1 for never. Unit: share of
    the training. Source: own."""
    lens_frozen_until: float = 0.0
    """Until when a lens that was measured keeps its value. Unit: share of the training. Source: own."""
    lens_within: float = 2.0
    """How far a measured lens may be learned away from its value; 0 for any distance. Unit: standard deviations of
    the measurement. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_init_aperture <= 0:
            raise InputError(
                "option lens_init_aperture",
                str(self.lens_init_aperture),
                "more than 0: a closed lens blurs nothing, so its aperture would get no gradient",
            )
        if self.lens_range == "render" and self.lens_measured_at < 1:
            found = f"{self.lens_measured_at:g} with lens_range=render"
            raise InputError("option lens_measured_at", found, "1: lenses are measured in the points' range")
        if self.lens_range == "render" and self.lens_per not in ("view", "scene"):
            raise InputError(
                "option lens_per",
                f"{self.lens_per} with lens_range=render",
                "view or scene: an aperture in units of each view's own range can't be shared",
            )


class LearnedLenses:
    """A lens per view, or lenses that views share in part (`Ties`), in normalised disparity d.

    The signed CoC radius is `slope * d + offset`, in units of 2 % of the width: with aperture A and focus F, slope = A
    and offset = -A F. Parameterisations (`lens_activation`): "relu" (released code), A and F, both through a relu;
    "log", log A and F, so that A can't become zero, where its gradient would vanish, and F may be outside the range;
    "ends", the signed CoC radii at d = 0 and d = 1, which affect the image equally strongly whatever A is, while the
    effect of F vanishes with A. Views that share an aperture learn, with "ends", that aperture and their own CoC radius
    at d = 1/2. Estimates are in scene units, so they are compared with the truth without a fit.
    """

    def __init__(
        self,
        count: int,
        disparity_range: DisparityRange,
        options: LensOptions,
        ties: Ties | None = None,
        device: torch.device | str = "cpu",
    ):
        self._options, self._first_range = options, disparity_range
        self.ranges = [disparity_range] * count
        self._ties = Ties.untied(count) if ties is None else ties
        self._limits: list[tuple[tuple[float, float], tuple[float, float]]] = []  # of aperture and focus, by view
        self._numbers = (self._ties.aperture, self._ties.focus)
        self._tables = [
            RowAdam(torch.full((max(numbers) + 1, 1), value, device=device), dense=options.lens_update == "dense")
            for numbers, value in zip(self._numbers, self._start(), strict=True)
        ]

    def _start(self) -> tuple[float, float]:
        return self._raw_of(self._options.lens_init_aperture, self._options.lens_init_focus)

    def _raw_of(self, aperture: float, focus: float, opening: float = 1.0) -> tuple[float, float]:
        """The raw parameters of a lens of this shared aperture and focus, for a view of this opening."""
        match self._options.lens_activation:
            case "relu":
                return aperture, focus
            case "log":
                return math.log(aperture), focus
        if self._ties.tied:
            return aperture, aperture * opening * (0.5 - focus)
        return -aperture * focus, aperture * (1 - focus)

    def _each(self, view: int) -> Iterator[tuple[RowAdam, int]]:
        """The tables of both parameters, and the view's row in each."""
        return zip(self._tables, (numbers[view] for numbers in self._numbers), strict=True)

    def _of(self, view: int) -> list[Tensor]:
        return [table.values[row, 0] for table, row in self._each(view)]

    def _coefficients(self, view: int, raw: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        opening = self._ties.opening[view]
        match self._options.lens_activation:
            case "relu":
                aperture, focus = torch.relu(raw[0]) + _FLOOR, torch.relu(raw[1]) + _FLOOR
            case "log":
                aperture, focus = torch.exp(raw[0]), raw[1]
            case _ if self._ties.tied:
                slope = raw[0] * opening
                return slope, raw[1] - 0.5 * slope
            case _ if opening == 1.0:
                return raw[1] - raw[0], raw[0]
            case _:
                return (raw[1] - raw[0]) * opening, raw[0] * opening
        aperture = aperture * opening
        return aperture, -aperture * focus

    def forward(self, view: int) -> tuple[Tensor, Tensor]:
        """Differentiable (slope, offset) of a view; keeps the parameters' leaf tensors for `step`."""
        return self._coefficients(view, [table.leaf(row)[0] for table, row in self._each(view)])

    def aperture_and_focus(self, view: int) -> tuple[float, float]:
        """A >= 1e-5 and F of a view. Blur doesn't depend on the sign of the slope."""
        slope, offset = (float(value) for value in self._coefficients(view, self._of(view)))
        if abs(slope) < _FLOOR:
            slope = math.copysign(_FLOOR, slope)
        return abs(slope), -offset / slope

    def gradient(self) -> Tensor | None:
        """(2,) gradient with respect to the raw parameters of the view of the last `forward`."""
        parts = [table.gradient for table in self._tables if table.gradient is not None]
        return torch.cat(parts) if len(parts) == len(self._tables) else None

    @property
    def follows_rendering(self) -> bool:
        """Whether disparities are normalised by the range of each rendering; then call `follow`."""
        return self._options.lens_range == "render"

    def follow(self, view: int, disparity: Tensor, alpha: Tensor) -> None:
        """Normalise a view by the range of its rendered disparity (H, W), 1 / scene unit; alpha: (H, W)."""
        self.ranges[view] = rendered_range(disparity, alpha, self._first_range)

    def step(self, view: int, progress: float, cooldown: float = 1.0) -> None:
        """One Adam step on a view, its rate times `cooldown`, once `lens_from` has passed. With `lens_update="dense"`
        every view's moments decay too. A measured lens stays within its limits."""
        options = self._options
        if progress < max(options.lens_from, options.lens_frozen_until if self._limits else 0.0):
            return
        rate = options.lens_lr * (options.lens_lr_final / options.lens_lr) ** progress * cooldown
        step_together(self._each(view), rate)
        if self._limits:
            self._limit(view)

    def _limit(self, view: int) -> None:
        """Return a view's lens to the nearest one within its limits."""
        lens, limits = self.aperture_and_focus(view), self._limits[view]
        inside = [min(max(value, low), high) for value, (low, high) in zip(lens, limits, strict=True)]
        if inside != list(lens):
            self._set(view, *inside)

    def _set(self, view: int, aperture: float, focus: float) -> None:
        opening = self._ties.opening[view]
        raw = self._raw_of(aperture / opening, focus, opening)
        for (table, row), value in zip(self._each(view), raw, strict=True):
            table.values[row] = value

    def estimate(self, view: int, width: int) -> PhysicalLens:
        """The learned lens of a view in scene units, for an image `width` px wide."""
        aperture, focus = self.aperture_and_focus(view)
        extent = self.ranges[view].extent
        return PhysicalLens(
            aperture=COC_FRACTION * width * aperture / extent,
            focus_disparity=self.ranges[view].q_min + focus * extent,
            width=width,
        )

    def shared(self, ties: Ties) -> LearnedLenses:
        """These lenses under the given ties: a shared aperture or focus is the median over the views that share it."""
        pairs = np.array([self.aperture_and_focus(view) for view in range(len(self.ranges))])
        apertures, foci = pairs[:, 0] / np.array(ties.opening), pairs[:, 1]
        lenses = LearnedLenses(len(self.ranges), self._first_range, self._options, ties, self._tables[0].values.device)
        lenses.ranges = list(self.ranges)
        for view in range(len(self.ranges)):
            number, place = ties.aperture[view], ties.focus[view]
            aperture = float(np.median(apertures[np.array(ties.aperture) == number]))
            focus = float(np.median(foci[np.array(ties.focus) == place]))
            first, second = lenses._raw_of(aperture, focus, ties.opening[view])
            lenses._tables[0].values[number], lenses._tables[1].values[place] = first, second
        return lenses

    def use(self, options: LensOptions) -> None:
        """Go on with other rates and times; values and what is shared stay as they are."""
        self._options = options

    def measured(self, aperture: np.ndarray, focus: np.ndarray, errors: np.ndarray, ties: Ties) -> LearnedLenses:
        """Lenses of these values under the given ties, with limits about them. aperture, focus: (V,), normalised.
        errors: (V, 2) standard deviations, of the aperture relative to it; the option lens_within scales them. Views
        that share a focus get the median of theirs."""
        shared = np.array(ties.focus)
        focus = np.array([np.median(focus[shared == place]) for place in shared])
        lenses = LearnedLenses(len(self.ranges), self._first_range, self._options, ties, self._tables[0].values.device)
        lenses.ranges, reach = list(self.ranges), self._options.lens_within or math.inf
        for view, (a, f, error) in enumerate(zip(aperture, focus, errors, strict=True)):
            lenses._set(view, float(a), float(f))
            factor, wide = math.exp(min(reach * float(error[0]), 50.0)), reach * float(error[1])
            lenses._limits.append(((float(a) / factor, float(a) * factor), (float(f) - wide, float(f) + wide)))
        return lenses

    def start_foci(self, foci: Sequence[float]) -> None:
        """Set the first foci, normalised disparity, one a view; views that share one get their median."""
        for view, (number, place) in enumerate(zip(self._ties.aperture, self._ties.focus, strict=True)):
            shared = [focus for focus, other in zip(foci, self._ties.focus, strict=True) if other == place]
            raw = self._raw_of(self._options.lens_init_aperture, float(np.median(shared)), self._ties.opening[view])
            self._tables[0].values[number], self._tables[1].values[place] = raw

    def spoil(self, value: float) -> None:
        """Set all parameters to `value`, such as NaN, for checks of a training's status."""
        for table in self._tables:
            table.values.fill_(value)

    def state(self) -> dict[str, np.ndarray]:
        """(V, 2) raw parameters of all views, and (V, 2) their disparity ranges."""
        return {
            "raw": torch.stack([torch.stack(self._of(view)) for view in range(len(self.ranges))]).numpy(force=True),
            "ranges": np.array([[r.q_min, r.q_max] for r in self.ranges]),
        }


_INSIDE = 0.02  # normalised disparity: margin of the first foci, since some beyond the range have no gradient


def first_lenses(
    views: Sequence[TrainingView],
    disparity_range: DisparityRange,
    options: LensOptions,
    device: torch.device | str = "cpu",
) -> LearnedLenses:
    """The lenses that a training starts from. Raises InputError where the options need missing EXIF."""
    ties = lens_ties(views, options.lens_per)
    lenses = LearnedLenses(len(views), disparity_range, options, ties, device)
    if options.lens_focus_from == "exif":
        lenses.start_foci(foci_by_exif(views, disparity_range, options.lens_init_focus))
    return lenses


def foci_by_exif(views: Sequence[TrainingView], disparity_range: DisparityRange, middle: float) -> list[float]:
    """Normalised disparity of each view's focus, in the ratios of 1 / distance in EXIF.

    EXIF's unit in scene units is unknown, so the median of the finite distances is put at `middle`. Infinity is the far
    end of the range; an unknown distance is `middle`. Raises InputError without any finite distance.
    """
    distances = [None if view.exif is None else view.exif.focus_distance for view in views]
    written = [None if distance is None else 1 / distance for distance in distances]
    finite = [disparity for disparity in written if disparity]
    if not finite:
        expected = "a finite focus distance of some training photograph, or lens_focus_from=option"
        raise InputError("option lens_focus_from", "exif, and no focus distance in EXIF", expected)
    unit = (disparity_range.q_min + middle * disparity_range.extent) / float(np.median(finite))
    return [
        middle if one is None else float(np.clip(disparity_range.normalise(unit * one), _INSIDE, 1 - _INSIDE))
        for one in written
    ]
