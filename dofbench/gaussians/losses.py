"""The terms of the full objective (Eq. 7 to 13); each returns a scalar tensor."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.gaussians.render import SURFACE_ALPHA
from dofbench.kernels import load
from dofbench.learning.options import TrainerOptions
from dofbench.learning.supervision import DepthSamples

WHITE = 254.5 / 255  # what an image of eight bits can't tell from white


def reconstruction(prediction: Tensor, target: Tensor, ssim_weight: float, weight: Tensor | None) -> Tensor:
    """Eq. 7: (1 - lambda) L1 + lambda (1 - SSIM); `weight` (H, W) acts on the L1 term."""
    return load("ssim", function="l1_ssim")(prediction, target, ssim_weight=ssim_weight, weight=weight)


def looked_at(
    prediction: Tensor,
    target: Tensor,
    held_back: Tensor | None = None,
    clipped_white: bool = False,
) -> Tensor:
    """The prediction with the target in its place where no loss may look: no difference there, and no gradient.

    prediction, target: (H, W, 3). held_back: (H, W) bool, or None for nothing held back. clipped_white: a channel at
    white in the target is whatever the sensor clipped, so any prediction at or above it is as good.
    """
    if clipped_white:
        prediction = torch.where((target >= WHITE) & (prediction >= target), target, prediction)
    return prediction if held_back is None else torch.where(held_back[..., None], target, prediction)


def step_function(x: Tensor, options: TrainerOptions) -> Tensor:
    """Eq. 10's Psi after the switch: 1 / (1 + exp(-a (x - b))), large where out of focus."""
    return torch.sigmoid(options.adaptation_a * (x - options.adaptation_b))


def adaptation_weight(out_of_focus: Tensor, options: TrainerOptions) -> Tensor | None:
    """(H, W) weight of the L1 terms; `out_of_focus` is |normalised disparity - focus|, detached.

    "psi" is Eq. 13 as printed. "one_minus_psi" is what the text describes; like the released code
    it first stretches x to [0, 1] within the image.
    """
    if options.adaptation == "off":
        return None
    if options.adaptation == "psi":
        return step_function(out_of_focus, options)
    low, high = out_of_focus.min(), out_of_focus.max()
    return 1 - step_function((out_of_focus - low) / (high - low).clamp(min=1e-12), options)


def depth_loss(
    depth: Tensor,
    alpha: Tensor,
    truth: DepthSamples,
    options: TrainerOptions,
    disparity_extent: float,
    weight: Tensor | None,
) -> Tensor | None:
    """Eq. 9 on the pixels whose depth is known; None when none of them has a surface yet.

    In "disparity" the difference is taken in normalised disparity, the quantity that sets the
    circle of confusion; in "depth" in scene units, as published.
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


def normals_from_depth(depth: Tensor, camera: Camera) -> Tensor:
    """(H-2, W-2, 3) unit normals in the camera's frame, towards it, by central differences.

    Back-projects z-depth (H, W) through the pixel centres.
    """
    height, width = depth.shape
    x = (torch.arange(width, dtype=depth.dtype) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(height, dtype=depth.dtype) + 0.5 - camera.cy) / camera.fy
    points = torch.stack([x * depth, y[:, None] * depth, depth], dim=-1)
    along_x = points[1:-1, 2:] - points[1:-1, :-2]
    along_y = points[2:, 1:-1] - points[:-2, 1:-1]
    return torch.nn.functional.normalize(torch.linalg.cross(along_y, along_x), dim=-1)


def normal_consistency(
    normal: Tensor,
    alpha: Tensor,
    depth: Tensor,
    median_depth: Tensor,
    camera: Camera,
    median_share: float,
    form: Literal["splats", "pixel"] = "splats",
) -> Tensor:
    """How far the rendered normals lie from the depth's, n^, averaged over the pixels within the border.

    "splats" is Eq. 12, the sum over a pixel's splats of w (1 - n . n^): alpha minus the blended normal along n^.
    "pixel" is 1 - n . n^ for the blended normal brought to unit length (released code); 1 where there is nothing.
    """
    if form == "pixel":
        there = alpha.detach()[..., None] > 0
        normal = torch.nn.functional.normalize(torch.where(there, normal, 1.0), dim=-1) * there
        alpha = torch.ones_like(alpha)
    loss = torch.zeros(())
    for share, surface in ((1 - median_share, depth), (median_share, median_depth)):
        if share > 0:
            geometric = normals_from_depth(surface, camera)
            agreement = (normal[1:-1, 1:-1] * geometric).sum(dim=-1)
            loss = loss + share * (alpha[1:-1, 1:-1] - agreement).mean()
    return loss


def distortion_loss(distortion: Tensor, alpha: Tensor, image: Tensor, near: float, far: float) -> Tensor:
    """The released code's distortion loss (docs/published-methods.md, "Losses"): pulls a ray's Gaussians together.

    The mean over the pixels of distortion / alpha^2, of depth mapped to [0, 1] by m = (f z - f n) / ((f - n) z), times
    exp(-g); g is the largest absolute difference of the photograph's colour, mean over its channels, to the four
    neighbours, since depth may jump where colour does. Pixels at the border count as 0. distortion: (H, W),
    1 / scene unit^2, the rasteriser's, of disparity; divided by alpha^2 it is the variance of disparity among
    the pixel's Gaussians. image: (H, W, 3). near, far: scene units.
    """
    there = alpha.detach() > 0
    # m is affine in disparity: differences of m are this many times the differences of 1 / z.
    scale = far * near / (far - near)
    spread = scale**2 * distortion / torch.where(there, alpha, 1.0).square()
    inner = image[1:-1, 1:-1]
    neighbours = (image[1:-1, :-2], image[1:-1, 2:], image[:-2, 1:-1], image[2:, 1:-1])
    edges = torch.stack([(inner - neighbour).abs().mean(dim=-1) for neighbour in neighbours]).amax(dim=0)
    return (spread[1:-1, 1:-1] * torch.exp(-edges)).sum() / spread.numel()
