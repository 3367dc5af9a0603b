"""The learnable lens of every training view (DoF-Gaussian, section 4.1)."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.gaussians.options import TrainerOptions
from dofbench.lens import COC_FRACTION, DisparityRange, PhysicalLens

_RELU_FLOOR = 1e-5  # the released code adds it after the relu
_BETAS = (0.9, 0.999)
_EPSILON = 1e-15


class LearnedLenses:
    """Aperture and focus per view, in the method's own normalised disparity.

    The method's range comes from what it may see (its sparse points, or each rendered view); the
    estimate leaves it in scene units, so nothing has to be fitted to compare it with the truth.
    """

    def __init__(self, count: int, disparity_range: DisparityRange, options: TrainerOptions):
        self._options = options
        self.ranges = [disparity_range] * count
        start = options.lens_init_aperture
        aperture = start if options.lens_activation == "relu" else math.log(start)
        self._raw = [torch.tensor([aperture, options.lens_init_focus]) for _ in range(count)]
        self._first = torch.zeros(count, 2)
        self._second = torch.zeros(count, 2)
        self._visits = torch.zeros(count)
        self._steps = 0
        self._leaf: Tensor | None = None

    def activated(self, raw: Tensor) -> tuple[Tensor, Tensor]:
        """Normalised aperture and focus from the two raw numbers."""
        if self._options.lens_activation == "relu":
            return torch.relu(raw[0]) + _RELU_FLOOR, torch.relu(raw[1]) + _RELU_FLOOR
        return torch.exp(raw[0]), raw[1]

    def forward(self, index: int) -> tuple[Tensor, Tensor]:
        """Differentiable (A, F) of view `index`; remembers the leaf for `step`."""
        self._leaf = self._raw[index].clone().requires_grad_()
        return self.activated(self._leaf)

    def gradient(self) -> Tensor | None:
        """(2,) gradient by the raw parameters of the view of the last `forward`."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, index: int, progress: float) -> None:
        """One Adam step on view `index`; with `lens_update="dense"` every view's moments decay too."""
        assert self._leaf is not None and self._leaf.grad is not None
        options = self._options
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

    def estimate(self, index: int, width: int) -> PhysicalLens:
        """The learned lens of view `index` in scene units, for an image `width` pixels wide."""
        aperture, focus = (float(value) for value in self.activated(self._raw[index]))
        extent = self.ranges[index].extent
        return PhysicalLens(
            aperture=COC_FRACTION * width * aperture / extent,
            focus_disparity=self.ranges[index].q_min + focus * extent,
            width=width,
        )

    def state(self) -> dict[str, np.ndarray]:
        """Raw parameters and disparity ranges of all views."""
        return {
            "raw": torch.stack(self._raw).numpy(),
            "ranges": np.array([[r.q_min, r.q_max] for r in self.ranges]),
        }
