"""Robust Gaussian Splatting's model of defocus (Darmon et al., 2024): one learned blur for each view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.training.common.row_adam import RowAdam
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import LenslessMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions

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


class UniformBlur(LearnedBlur):
    """A variance for each view that enlarges every footprint: the paper's offset of the footprints' covariance.

    The paper's code isn't public. Here the offset is round and keeps a Gaussian's integral over the image. The blur
    doesn't depend on depth, so it explains the mean of a view with shallow depth of field.
    """

    needs_sharp_render = False
    samples_aperture = True

    def __init__(self, views: int, options: UniformBlurOptions, device: torch.device | str = "cpu"):
        self._options = options
        self._table = RowAdam(torch.full((views, 1), options.view_blur_init, device=device))

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Rasterise the enlarged Gaussians."""
        assert shot.number is not None
        deviation = self._table.leaf(shot.number) * shot.camera.width * _PER_MILLE
        count = len(scene.gaussians)
        still = scene.gaussians.parameters["means"].new_zeros(count)
        return scene.rasterise_from_points(shot.camera, _CENTRE, still, deviation.square().expand(count))[0]

    def deviations(self) -> Tensor:
        """(V,) standard deviations of the views' blur, per mille of the width."""
        return self._table.values[:, 0]

    def gradient(self) -> Tensor | None:
        return self._table.gradient

    def step(self, view: int, progress: float, cooldown: float) -> None:
        self._table.step(view, self._options.view_blur_lr * cooldown)


@dataclass(frozen=True)
class RobustOptions(GaussianOptions):
    """The trainer's options, and those of the blur."""

    uniform: UniformBlurOptions = UniformBlurOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur:
        return UniformBlur(len(start.cameras), self.uniform, start.means.device)


class RobustSplatting(LenslessMethod):
    """Gaussians without a lens, and a round blur for each training view."""

    OPTIONS = RobustOptions
