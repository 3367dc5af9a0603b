"""Depth supervision (DoF-Gaussian, Eq. 9): rendered depth against what is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from dofbench.learning.rendered_surface import SURFACE_ALPHA
from dofbench.learning.supervision import DepthSamples


@dataclass(frozen=True)
class SupervisionOptions:
    """How strongly known depth supervises the rendered one, and in which measure."""

    depth_weight: float = 0.01
    """w_d, the weight of depth supervision at the start; 0 switches it off. Unit: 1 / scene unit, or none in disparity.
    Source: Eq. 9, supplement."""
    depth_norm: Literal["l1", "l2"] = "l2"
    """Of the differences over the known pixels: l2, the root of the mean square, or l1, the mean. Unit: none.
    Source: l2: Eq. 9; l1: released code."""
    depth_space: Literal["depth", "disparity"] = "depth"
    """What differences are taken of: z-depth, or normalised disparity, which sets the circle of confusion. Unit: none.
    Source: depth: Eq. 9; disparity: own."""
    depth_decay: float = 0.1
    """Factor on the weight that is reached at the end, linearly. Unit: none. Source: supplement, released code."""

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
) -> Tensor | None:
    """Eq. 9 on the pixels whose depth is known; None when none of them has a surface yet.

    depth: (H, W) z, scene units. alpha: (H, W). weight: (H, W), or None. disparity_extent: 1 / scene unit, that of the
    range which normalised disparity refers to. In "disparity" the difference is taken in normalised disparity, the
    quantity that sets the circle of confusion; in "depth" in scene units, as published.
    """
    there = alpha.detach()[truth.rows, truth.columns] > SURFACE_ALPHA
    if not bool(there.any()):
        return None
    rows, columns = truth.rows[there], truth.columns[there]
    rendered, expected = depth[rows, columns], truth.depth[there]
    if options.depth_space == "disparity":
        difference = (1 / rendered - 1 / expected) / disparity_extent
    else:
        difference = rendered - expected
    error = difference.abs() if options.depth_norm == "l1" else difference.square()
    if truth.weight is not None:
        share = truth.weight[there]
        error = error * (share / share.mean())
    if weight is not None:
        error = error * weight[rows, columns]
    # The root of the mean square is the norm of Eq. 9 made independent of the number of points.
    return error.mean() if options.depth_norm == "l1" else error.mean().clamp(min=1e-12).sqrt()
