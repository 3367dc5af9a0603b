"""Depth supervision (DoF-Gaussian, Eq. 9): the loss of rendered depth against known depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.ops import load
from dofbench.training.common.rendered_surface import SURFACE_ALPHA
from dofbench.training.common.supervision import DepthSamples

_LEAST_SQUARE = 1e-12  # whose root has a finite slope


@dataclass(frozen=True)
class SupervisionOptions:
    """How strongly known depth supervises rendered depth, and how their difference is measured."""

    depth_weight: float = 0.01
    """w_d, the weight of depth supervision at the start; 0 switches it off. Unit: 1 / scene unit, or none in disparity.
    Source: Eq. 9, supplement."""
    depth_norm: Literal["l1", "l2"] = "l2"
    """How the differences at the known pixels are averaged: l2, root of the mean square; l1, mean absolute value. Unit:
    none. Source: l2: Eq. 9; l1: released code."""
    depth_space: Literal["depth", "disparity"] = "depth"
    """The quantity whose differences are taken: z-depth, or normalised disparity, in which the circle of confusion is
    linear. Unit: none. Source: depth: Eq. 9; disparity: own."""
    depth_decay: float = 0.1
    """Factor on depth_weight that is reached linearly at the end of the training. Unit: none. Source: supplement,
    released code."""

    depth_every: int = 1
    """In which steps depth is supervised: every so many, with as many times the weight. A forward model that needs no
    sharp view, such as lens points, then rasterises none in the others. Unit: steps. Source: own."""

    def __post_init__(self) -> None:
        if self.depth_every < 1:
            raise InputError("option depth_every", str(self.depth_every), "at least 1")

    def weight_at(self, progress: float) -> float:
        """The weight of depth supervision at `progress`, 0 to 1: w_d, falling linearly (supplement; released code)."""
        return self.depth_weight * (1 - (1 - self.depth_decay) * progress)


def depth_loss(
    depth: Tensor,
    alpha: Tensor,
    truth: DepthSamples,
    options: SupervisionOptions,
    disparity_extent: float,
    weight: Tensor | None,
) -> Tensor:
    """Eq. 9 on the pixels of known depth that show a rendered surface; without a gradient while none does.

    depth: (H, W) z, scene units. alpha: (H, W). weight: (H, W), or None. disparity_extent: width of the disparity range
    that normalised disparity refers to, 1 / scene unit. With "disparity" the difference is taken in normalised
    disparity, in which the circle of confusion is linear; with "depth" in scene units, as published.
    """
    squared = options.depth_norm == "l2"
    mean: Tensor = load("surface", function="known_depth")(
        depth,
        alpha,
        truth.rows,
        truth.columns,
        truth.depth,
        truth.weight,
        weight,
        most=truth.most,
        least_alpha=SURFACE_ALPHA,
        extent=disparity_extent if options.depth_space == "disparity" else None,
        squared=squared,
    )
    # The root of the mean square is the norm of Eq. 9 made independent of the number of points.
    return mean.clamp(min=_LEAST_SQUARE).sqrt() if squared else mean
