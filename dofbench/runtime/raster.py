"""What every backend of `rasterize` gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from torch import Tensor

Geometry = Literal["none", "depth", "full", "distortion"]
GEOMETRIES: tuple[Geometry, ...] = ("none", "depth", "full", "distortion")


class Raster(NamedTuple):
    """One rendered view.

    color: (H, W, 3), composited over the background. alpha: (H, W), the sum of the blending weights. depth: (H, W),
    z-depth in scene units, the mean with the blending weights, 0 where alpha is 0. median_depth: (H, W), z-depth in
    scene units, 0 where alpha is 0. normal: (H, W, 3), camera frame, towards the camera, the weighted sum (its length
    is at most alpha). distortion: (H, W), 1 / scene unit**2, the sum over all pairs of Gaussians i, j of w_i w_j (1/z_i
    - 1/z_j)**2 with the blending weights w and the Gaussians' z-depths z at the pixel (2DGS defines it on mapped depth,
    which is affine in disparity). A field is None if the `geometry` asked for doesn't include it.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    median_depth: Tensor | None
    normal: Tensor | None
    distortion: Tensor | None


@dataclass(eq=False)
class ViewStatistics:
    """What density control needs to know about one view; filled in by `rasterize` and its backward pass.

    want_abs: also compute `abs_grad_2d`. After the forward pass: visible (N,) bool, whether the region
    of alpha >= 1/255 may hold a pixel centre; radii (N,) float, pixels, three standard deviations along
    the longer axis of the filtered footprint, 0 where invisible. After the backward pass: grad_2d (N, 2), the
    derivative of the loss with respect to the projected mean in pixels, and abs_grad_2d (N, 2), the same with the
    absolute value taken for each pixel before summing (AbsGS; Gaussian Opacity Fields).
    """

    want_abs: bool = False
    visible: Tensor | None = None
    radii: Tensor | None = None
    grad_2d: Tensor | None = None
    abs_grad_2d: Tensor | None = None
