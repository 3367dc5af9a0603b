"""The fall of light towards a photograph's corners, shared by all photographs of one lens at one f-number.

Light at the distance r from the principal point, in units of half the diagonal, is 1 + k1 r^2 + k2 r^4 times that in
the middle, in linear light (Goldman and Chen, 2005, whose polynomial goes on to r^6).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dofbench.cameras import Camera
from dofbench.exif import Exif
from dofbench.gaussians.options import TrainerOptions
from dofbench.gaussians.row_adam import RowAdam

_LEAST = 0.05  # share of light that is left anywhere


class LearnedVignetting:
    """k1 and k2 for each lens and f-number that EXIF knows, from none; photographs without EXIF share one."""

    def __init__(self, exif: Sequence[Exif | None], options: TrainerOptions):
        self._options = options
        kinds = [None if one is None else (one.camera, one.lens, one.focal_length, one.f_number) for one in exif]
        order = list(dict.fromkeys(kinds))
        self._group = [order.index(kind) for kind in kinds]
        self._table = RowAdam(len(order), 2)

    def forward(self, view: int, image: Tensor, camera: Camera) -> Tensor:
        """The encoded image (H, W, 3) under the vignetting of view number `view`; differentiable by both."""
        return self._applied(self._table.leaf(self._group[view]), image, camera)

    def gradient(self) -> Tensor | None:
        """(2,) gradient by k1 and k2 of the view of the last `forward`."""
        return self._table.gradient

    def step(self, view: int, progress: float) -> None:
        """One Adam step on a view's group."""
        options = self._options
        rate = options.colour_lr * options.colour_lr_fall**progress * options.cooldown(progress)
        self._table.step(self._group[view], rate)

    @torch.no_grad()
    def apply(self, view: int, image: Tensor, camera: Camera) -> Tensor:
        """As `forward`, without gradient."""
        return self._applied(self._table.values[self._group[view]], image, camera)

    def coefficients(self, view: int) -> tuple[float, float]:
        """k1 and k2 of view number `view`."""
        k1, k2 = self._table.values[self._group[view]].tolist()
        return k1, k2

    def _applied(self, k: Tensor, image: Tensor, camera: Camera) -> Tensor:
        x = (torch.arange(camera.width) + 0.5 - camera.cx) / (0.5 * (camera.width**2 + camera.height**2) ** 0.5)
        y = (torch.arange(camera.height) + 0.5 - camera.cy) / (0.5 * (camera.width**2 + camera.height**2) ** 0.5)
        square = (x.square() + y[:, None].square()).to(image.dtype)
        light = (1 + k[0] * square + k[1] * square.square()).clamp_min(_LEAST)
        return image * (light ** (1 / self._options.lens_gamma))[..., None]
