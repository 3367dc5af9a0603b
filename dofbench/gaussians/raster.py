"""What the rasteriser kernel gives back, whatever its backend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from torch import Tensor

Geometry = Literal["none", "depth", "full"]


class Raster(NamedTuple):
    """color (H, W, 3) encoded; alpha (H, W); depth (H, W) expected z, scene units, 0 where empty;
    median_depth (H, W); normal (H, W, 3), camera frame, weighted sum, not normalised.

    What the requested geometry leaves out is None.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    median_depth: Tensor | None
    normal: Tensor | None


@dataclass
class ViewStatistics:
    """Per-Gaussian numbers of one view that density control asks for.

    The forward pass fills visible (N,) bool and radii (N,) float32 pixels; the backward pass
    grad_2d (N, 2), the loss's gradient by the projected means in pixels, and with `want_abs`
    abs_grad_2d (N, 2), the sum over pixels of its absolute contributions (AbsGS).
    """

    want_abs: bool = False
    visible: Tensor | None = None
    radii: Tensor | None = None
    grad_2d: Tensor | None = None
    abs_grad_2d: Tensor | None = None
