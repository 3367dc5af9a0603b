"""The learnable lens of every training view (DoF-Gaussian, section 4.1)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens
from dofbench.training.common.lens_ties import LensPer, Ties
from dofbench.training.common.rendered_surface import rendered_range
from dofbench.training.common.row_adam import RowAdam, step_together

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

    def __post_init__(self) -> None:
        if self.lens_init_aperture <= 0:
            raise InputError(
                "option lens_init_aperture",
                str(self.lens_init_aperture),
                "more than 0: a closed lens blurs nothing, so its aperture would get no gradient",
            )
        if self.lens_range == "render" and self.lens_per not in ("view", "scene"):
            raise InputError(
                "option lens_per",
                f"{self.lens_per} with lens_range=render",
                "view or scene: an aperture in units of each view's own range can't be shared",
            )


class LearnedLenses:
    """A lens per view, or lenses that views share in part (`lens_ties.py`), in the method's own normalised disparity d.

    Every parameterisation stands for the signed circle of confusion `slope * d + offset`, in units of 2 % of the width:
    with aperture A and focus F, slope = A and offset = -A F. Parameterisations (`lens_activation`):

    "relu" (released code): A and F are learned, both through a relu. "log": log A and F are learned, so A can't become
    zero, where its gradient would vanish, and F may lie outside the range. "ends": the signed circles at d = 0 and at d
    = 1 are learned. They affect the image equally strongly whatever A is, while the effect of F vanishes when A is
    small. Where views share an aperture, "ends" learns that aperture and each view's circle at d = 1/2, which is the
    same lens in other coordinates.

    The disparity range comes from data that the method may see (its sparse points, or each rendered view). Estimates
    are given in scene units, so they can be compared with the truth without a fit.
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
        self._numbers = (self._ties.aperture, self._ties.focus)
        self._tables = [
            RowAdam(torch.full((max(numbers) + 1, 1), value, device=device), dense=options.lens_update == "dense")
            for numbers, value in zip(self._numbers, self._start(), strict=True)
        ]

    def _start(self) -> tuple[float, float]:
        return self._raw_of(self._options.lens_init_aperture, self._options.lens_init_focus)

    def _raw_of(self, aperture: float, focus: float, opening: float = 1.0) -> tuple[float, float]:
        """The raw parameters of a lens of this shared aperture, with the focus of a view of this opening."""
        match self._options.lens_activation:
            case "relu":
                return aperture, focus
            case "log":
                return math.log(aperture), focus
        if self._ties.tied:
            return aperture, aperture * opening * (0.5 - focus)
        return -aperture * focus, aperture * (1 - focus)

    def _each(self, view: int) -> Iterator[tuple[RowAdam, int]]:
        """The tables of both parameters, and the rows of `view` in them."""
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
        """Differentiable (slope, offset) of view number `view`; keeps the parameters' leaf tensors for `step`."""
        return self._coefficients(view, [table.leaf(row)[0] for table, row in self._each(view)])

    def aperture_and_focus(self, view: int) -> tuple[float, float]:
        """A >= 1e-5 and F of view number `view`. Blur doesn't depend on the sign of the slope."""
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
        """Whether each view's disparities are normalised by the range of its rendering; then call `follow`."""
        return self._options.lens_range == "render"

    def follow(self, view: int, disparity: Tensor, alpha: Tensor) -> None:
        """Normalise view number `view` by the range of its rendered disparity (H, W), 1 / scene unit; alpha: (H, W)."""
        self.ranges[view] = rendered_range(disparity, alpha, self._first_range)

    def step(self, view: int, progress: float, cooldown: float = 1.0) -> None:
        """One Adam step on view number `view`, its rate times `cooldown`, once `lens_from` has passed.

        With `lens_update="dense"` every view's moments decay too.
        """
        options = self._options
        if progress < options.lens_from:
            return
        rate = options.lens_lr * (options.lens_lr_final / options.lens_lr) ** progress * cooldown
        step_together(self._each(view), rate)

    def estimate(self, view: int, width: int) -> PhysicalLens:
        """The learned lens of view number `view` in scene units, for an image `width` pixels wide."""
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

    def start_foci(self, foci: Sequence[float]) -> None:
        """Set the foci that training starts from, normalised disparity, one a view; views that share one get their
        median."""
        for view, (number, place) in enumerate(zip(self._ties.aperture, self._ties.focus, strict=True)):
            shared = [focus for focus, other in zip(foci, self._ties.focus, strict=True) if other == place]
            raw = self._raw_of(self._options.lens_init_aperture, float(np.median(shared)), self._ties.opening[view])
            self._tables[0].values[number], self._tables[1].values[place] = raw

    def spoil(self, value: float) -> None:
        """Set all parameters to `value`, such as NaN: for checks that training ends with the right status."""
        for table in self._tables:
            table.values.fill_(value)

    def state(self) -> dict[str, np.ndarray]:
        """(V, 2) raw parameters of all views, and (V, 2) their disparity ranges."""
        return {
            "raw": torch.stack([torch.stack(self._of(view)) for view in range(len(self.ranges))]).numpy(force=True),
            "ranges": np.array([[r.q_min, r.q_max] for r in self.ranges]),
        }
