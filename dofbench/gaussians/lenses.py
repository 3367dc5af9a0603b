"""The learnable lens of every training view (DoF-Gaussian, section 4.1)."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.gaussians.options import TrainerOptions
from dofbench.lens import COC_FRACTION, DisparityRange, PhysicalLens

_FLOOR = 1e-5  # least aperture; the released code adds it after the relu
_BETAS = (0.9, 0.999)
_EPSILON = 1e-15


class LearnedLenses:
    """A lens per view, or one for all views, in the method's own normalised disparity d.

    Whatever is learned, it means the signed circle of confusion `slope * d + offset`, in units of 2 % of the width:
    with aperture A and focus F, slope = A and offset = -A F. Parameterisations (`lens_activation`):

    "relu" (released): A and F are learned, both through a relu. "log": log A and F are, so A can't end at zero, where
    no gradient would be left, and F may lie beyond the range. "ends": the signed circles at d = 0 and at d = 1, whose
    pull on the image is alike in strength whatever A is, where F has none left when A is small.

    The method's range comes from what it may see (its sparse points, or each rendered view); the
    estimate leaves it in scene units, so nothing has to be fitted to compare it with the truth.
    """

    def __init__(self, count: int, disparity_range: DisparityRange, options: TrainerOptions):
        self._options = options
        self.ranges = [disparity_range] * count
        learned = count if options.lens_per == "view" else 1
        self._raw = [torch.tensor(self._start()) for _ in range(learned)]
        self._first = torch.zeros(learned, 2)
        self._second = torch.zeros(learned, 2)
        self._visits = torch.zeros(learned)
        self._steps = 0
        self._leaf: Tensor | None = None

    def _start(self) -> tuple[float, float]:
        aperture, focus = self._options.lens_init_aperture, self._options.lens_init_focus
        match self._options.lens_activation:
            case "relu":
                return aperture, focus
            case "log":
                return math.log(aperture), focus
        return -aperture * focus, aperture * (1 - focus)

    def _lens_of(self, view: int) -> int:
        return view if len(self._raw) > 1 else 0

    def _coefficients(self, raw: Tensor) -> tuple[Tensor, Tensor]:
        match self._options.lens_activation:
            case "relu":
                aperture, focus = torch.relu(raw[0]) + _FLOOR, torch.relu(raw[1]) + _FLOOR
            case "log":
                aperture, focus = torch.exp(raw[0]), raw[1]
            case _:
                return raw[1] - raw[0], raw[0]
        return aperture, -aperture * focus

    def forward(self, view: int) -> tuple[Tensor, Tensor]:
        """Differentiable (slope, offset) of view number `view`; remembers the leaf for `step`."""
        self._leaf = self._raw[self._lens_of(view)].clone().requires_grad_()
        return self._coefficients(self._leaf)

    def aperture_and_focus(self, view: int) -> tuple[float, float]:
        """A >= 1e-5 and F of view number `view`. Blur doesn't depend on the sign of the slope."""
        slope, offset = (float(value) for value in self._coefficients(self._raw[self._lens_of(view)]))
        if abs(slope) < _FLOOR:
            slope = math.copysign(_FLOOR, slope)
        return abs(slope), -offset / slope

    def gradient(self) -> Tensor | None:
        """(2,) gradient by the raw parameters of the view of the last `forward`."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, view: int, progress: float) -> None:
        """One Adam step on view number `view`; with `lens_update="dense"` every view's moments decay too."""
        assert self._leaf is not None and self._leaf.grad is not None
        options, index = self._options, self._lens_of(view)
        rate = options.lens_lr * (options.lens_lr_final / options.lens_lr) ** progress * options.cooldown(progress)
        self._steps += 1
        self._visits[index] += 1
        beta1, beta2 = _BETAS
        gradient = self._leaf.grad
        if options.lens_update == "view":
            rows, visits = slice(index, index + 1), float(self._visits[index])
        else:
            rows, visits = slice(None), float(self._steps)
        full = torch.zeros_like(self._first[rows])
        full[0 if options.lens_update == "view" else index] = gradient
        self._first[rows] = beta1 * self._first[rows] + (1 - beta1) * full
        self._second[rows] = beta2 * self._second[rows] + (1 - beta2) * full * full
        change = (self._first[rows] / (1 - beta1**visits)) / (
            torch.sqrt(self._second[rows] / (1 - beta2**visits)) + _EPSILON
        )
        for offset, i in enumerate(range(len(self._raw))[rows]):
            self._raw[i] = self._raw[i] - rate * change[offset]
        self._leaf = None

    def estimate(self, view: int, width: int) -> PhysicalLens:
        """The learned lens of view number `view` in scene units, for an image `width` pixels wide."""
        aperture, focus = self.aperture_and_focus(view)
        extent = self.ranges[view].extent
        return PhysicalLens(
            aperture=COC_FRACTION * width * aperture / extent,
            focus_disparity=self.ranges[view].q_min + focus * extent,
            width=width,
        )

    def state(self) -> dict[str, np.ndarray]:
        """Raw parameters of all lenses and disparity ranges of all views."""
        return {
            "raw": torch.stack(self._raw).numpy(),
            "ranges": np.array([[r.q_min, r.q_max] for r in self.ranges]),
        }
