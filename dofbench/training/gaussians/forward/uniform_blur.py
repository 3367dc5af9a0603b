"""One blur for a whole photograph: a variance, learned for each, that every footprint is enlarged by (Darmon et al.,
Robust Gaussian Splatting, 2024: an offset of the footprints' covariance for each image).

The paper's code isn't public. Here the offset is round, and keeps a Gaussian's integral over the image. The blur
doesn't depend on depth, so of a photograph with shallow depth of field it explains the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.raster import Geometry
from dofbench.training.common.row_adam import RowAdam
from dofbench.training.gaussians.forward.forward_model import ForwardModel, Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.shot import Shot

_PER_MILLE = 1e-3
_CENTRE = np.zeros((1, 2))  # of the lens: the view isn't moved


@dataclass(frozen=True)
class UniformBlurOptions:
    """How the blur of whole photographs is learned."""

    view_blur_init: float = 1.0
    """Standard deviation of every photograph's blur at the start; at 0 it would have no gradient. Unit: per mille of
    the width. Source: own."""
    view_blur_lr: float = 0.02
    """Adam's learning rate of these standard deviations. Unit: per mille of the width, a step. Source: own."""

    def __post_init__(self) -> None:
        if not self.view_blur_init > 0:
            raise InputError("option view_blur_init", str(self.view_blur_init), "more than 0")


class UniformBlur(WithoutCost):
    """A `ForwardModel` and `LearnedBlur`."""

    reads: Geometry = "none"
    looks = False
    from_points = True
    stage = "blur"
    kernels: tuple[str, ...] = ()

    def __init__(self, views: int, options: UniformBlurOptions, device: torch.device | str = "cpu"):
        self._options = options
        self._table = RowAdam(torch.full((views, 1), options.view_blur_init, device=device))

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """This model, all the time."""
        return [(0.0, self)]

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The scene of enlarged Gaussians."""
        assert shot.number is not None
        deviation = self._table.leaf(shot.number) * shot.camera.width * _PER_MILLE
        count = len(scene.gaussians)
        still = scene.gaussians.parameters["means"].new_zeros(count)
        return scene.from_points(shot.camera, _CENTRE, still, deviation.square().expand(count))[0]

    def deviations(self) -> Tensor:
        """(V,) standard deviations of the photographs' blur, per mille of the width."""
        return self._table.values[:, 0]

    def gradient(self) -> Tensor | None:
        """That by the last photograph's standard deviation."""
        return self._table.gradient

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """An Adam step on a photograph's standard deviation."""
        self._table.step(view, self._options.view_blur_lr * cooldown)
