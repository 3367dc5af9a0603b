"""Known depth of a view (DoF-Gaussian, section 4.2), rendered disparity, and the depth loss (Eq. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange
from dofbench.runtime.ops import load
from dofbench.scenes.visibility import visible
from dofbench.training.common.depth_map import DepthSamples

SURFACE_ALPHA = 0.1  # a pixel with less accumulated opacity has no surface with a meaningful depth
_RANGE_QUANTILE = 0.95  # near end of the disparity range in the released code
_LEAST_SQUARE = 1e-12  # whose root has a finite slope


def sparse_depth(points: PointCloud, camera: Camera, view: int) -> DepthSamples:
    """Depth of the points that view number `view` sees, at their pixels."""
    seen = visible(points, camera, view)
    pixels = seen.xy.astype(np.int32)
    return DepthSamples(
        rows=torch.from_numpy(pixels[:, 1].copy()),
        columns=torch.from_numpy(pixels[:, 0].copy()),
        depth=torch.from_numpy(seen.depth.astype(np.float32)),
    )


def all_disparities(points: PointCloud, cameras: Sequence[Camera]) -> np.ndarray:
    """Disparities, 1 / scene unit, of all points over all views that see them."""
    found = [1.0 / sparse_depth(points, camera, index).depth.numpy() for index, camera in enumerate(cameras)]
    return np.concatenate(found)


def surface_disparity(depth: Tensor, alpha: Tensor) -> Tensor:
    """(H, W) disparity, 1 / scene unit. A pixel without a surface gets the image's farthest disparity.

    The released code takes such pixels as the nearest of all, which spreads the blur of holes. Here they count as far,
    since a hole shows what is behind.
    """
    disparity: Tensor = load("surface")(depth, alpha, SURFACE_ALPHA)
    return disparity


def rendered_range(disparity: Tensor, alpha: Tensor, fallback: DisparityRange) -> DisparityRange:
    """Minimum and 95th percentile of disparity (H, W) over the pixels with a surface, as in the released code;
    `fallback` if there is no such pixel, or all have the same disparity."""
    known = disparity.detach()[alpha.detach() > SURFACE_ALPHA].numpy(force=True)
    if known.size == 0:
        return fallback
    low, high = float(known.min()), float(np.quantile(known, _RANGE_QUANTILE))
    return DisparityRange(low, high) if high > low else fallback


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
        """The weight at `progress`, 0 to 1: w_d, falling linearly (supplement; released code)."""
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
    of normalised disparity, 1 / scene unit. The difference is in scene units with "depth", as published, and in
    normalised disparity with "disparity".
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
