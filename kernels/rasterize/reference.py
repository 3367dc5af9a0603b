"""The definition of `rasterize` in plain torch, for any floating type; gradients by autograd. See op.py.

Every Gaussian is evaluated at every pixel, so this is for small scenes only.
"""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.raster import Raster, ViewStatistics

from .op import EDGE_ON, MAX_ALPHA, MIN_ALPHA, MIN_DETERMINANT, MIN_TRANSMITTANCE, View

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


class _Kind(TypedDict):
    dtype: torch.dtype
    device: torch.device


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """(N, 3, 3) from quaternions (N, 4), w first, any length; a zero quaternion gives the identity."""
    zero = (quaternions == 0).all(dim=1, keepdim=True)
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0]).to(quaternions)
    some = torch.where(zero, identity, quaternions)
    # Dividing by the largest component doesn't change the rotation, and keeps the squares from over- and underflowing.
    some = some / some.detach().abs().amax(dim=1, keepdim=True)
    w, x, y, z = torch.nn.functional.normalize(some, dim=1, eps=0.0).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def spherical_harmonics(directions: Tensor) -> Tensor:
    """(N, 16): 3DGS' real basis up to degree 3 in unit directions (N, 3), with its signs."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        1,
    )


class _Absolute(torch.autograd.Function):
    """The identity on one Gaussian's offsets (P, 2); adds the absolute values of its gradient to `total` (2,)."""

    @staticmethod
    def forward(ctx: Any, offsets: Tensor, total: Tensor) -> Tensor:
        ctx.total = total
        return offsets.clone()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        ctx.total += gradient.abs().sum(0)
        return gradient, None


def rasterize(
    parameters: tuple[Tensor, ...], blur: Tensor | None, view: View, statistics: ViewStatistics | None
) -> Raster:
    return _moved(parameters, None, blur, view, statistics)


def rasterize_from_points(
    parameters: tuple[Tensor, ...], blur: Tensor | None, radius: Tensor, points: np.ndarray, view: View,
    statistics: ViewStatistics | None,
) -> Tensor:  # fmt: skip
    if statistics is not None:
        raise ValueError("statistics: the reference has none from several points")
    lens = torch.tensor(points, dtype=radius.dtype, device=radius.device)
    return torch.stack([_moved(parameters, radius[:, None] * point, blur, view, None).color for point in lens])


def _moved(
    parameters: tuple[Tensor, ...], moved: Tensor | None, blur: Tensor | None, view: View,
    statistics: ViewStatistics | None,
) -> Raster:  # fmt: skip
    """`rasterize`, with the projected means moved by (N, 2) pixels, if `moved` is given."""
    camera, filter_3d, degree, background, filter_2d, fades, geometry, near = view
    means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest = parameters
    to: _Kind = {"dtype": means.dtype, "device": means.device}
    world_to_camera = torch.tensor(camera.world_to_camera, **to)
    rotation = world_to_camera[:3, :3]
    centre = torch.tensor(camera.centre.copy(), **to)
    width, height, fx, fy, cx, cy = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy

    # Projection. Gaussians at or behind the near plane are skipped from here on.
    local = means @ rotation.T + world_to_camera[:3, 3]
    index = torch.nonzero(local[:, 2] > near).squeeze(1)
    x, y, z = local[index].unbind(1)
    u, v = x / z, y / z
    # Positions farther than 0.3 half image sizes outside the image are clamped in the Jacobian, as in 3DGS.
    u_bounded = u.clamp((-cx - 0.15 * width) / fx, (width - cx + 0.15 * width) / fx)
    v_bounded = v.clamp((-cy - 0.15 * height) / fy, (height - cy + 0.15 * height) / fy)
    projected = torch.stack([fx * u + cx, fy * v + cy], 1)
    if moved is not None:
        projected = projected + moved[index]
    if projected.requires_grad:
        projected.retain_grad()

    axes = rotation @ rotation_matrices(quaternions)[index]
    bare_scales = log_scales[index].exp()
    filters = torch.zeros_like(means[:, 0]) if filter_3d is None else filter_3d.detach()
    scales = (bare_scales**2 + filters[index, None] ** 2).sqrt()
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([fx / z, zero, -fx * u_bounded / z], 1),
            torch.stack([zero, fy / z, -fy * v_bounded / z], 1),
        ],
        1,
    )
    factor = jacobian @ axes * scales[:, None, :]
    covariance = factor @ factor.mT
    filtered = covariance + filter_2d * torch.eye(2, **to)
    determinant, filtered_determinant = torch.linalg.det(covariance), torch.linalg.det(filtered)

    # Opacity: logistic, Mip-Splatting's 3D filter, then its 2D filter (docs/published-methods.md, "Mip-Splatting").
    shrink = torch.where(bare_scales == scales, torch.ones_like(scales), bare_scales / scales)
    opacity = torch.sigmoid(opacity_logits[index]) * shrink.prod(1)
    # 3DGS's dilation keeps the opacity, and so even a Gaussian that the camera sees edge-on is drawn.
    drawn = (determinant if fades else filtered_determinant) > MIN_DETERMINANT
    if fades:
        ratio = determinant / (filtered_determinant + MIN_DETERMINANT) + MIN_DETERMINANT
        opacity = opacity * torch.where(drawn, ratio, 1.0).sqrt()

    # The blur of each Gaussian, which doesn't change its integral over the image.
    drawn = drawn & (opacity > MIN_ALPHA)
    reach = (2 * torch.log(opacity.detach().clamp(min=MIN_ALPHA) / MIN_ALPHA)).sqrt()
    least_alpha = torch.full_like(z, MIN_ALPHA)
    if blur is not None:
        filtered = filtered + blur[index, None, None] * torch.eye(2, **to)
        before = torch.where(drawn, filtered_determinant, 1.0)
        share = (before / torch.where(drawn, torch.linalg.det(filtered), 1.0)).sqrt()
        opacity = opacity * share
        least_alpha = least_alpha * share.detach()

    # Gaussians that can reach their threshold of alpha, 1/255 without blur, at a pixel centre.
    with torch.no_grad():
        half = reach[:, None] * filtered.diagonal(dim1=1, dim2=2).sqrt()
        size = torch.tensor([width, height], **to)
        first = torch.ceil(projected - half - 0.5).clamp(min=0)
        last = torch.minimum(torch.floor(projected + half - 0.5), size - 1)
        drawn = drawn & (first <= last).all(1)
        longest = torch.linalg.eigvalsh(filtered)[:, 1]

    terms = (degree + 1) ** 2
    coefficients = torch.cat([sh_dc[:, None], sh_rest[:, : terms - 1]], 1)[index]
    directions = torch.nn.functional.normalize(means[index] - centre, dim=1, eps=0.0)
    colors = (0.5 + (spherical_harmonics(directions)[:, :terms, None] * coefficients).sum(1)).clamp(min=0)

    # RaDe-GS: the plane of largest density, as ray length affine in the pixel
    # (docs/published-methods.md, "Depth and normals of a Gaussian").
    ray = torch.stack([u_bounded, v_bounded, torch.ones_like(z)], 1)
    shape = scales.amin(1, keepdim=True) / scales
    inverse = axes @ ((shape**2)[:, :, None] * axes.mT)
    h = (inverse @ ray[:, :, None]).squeeze(2)
    along = (h * ray).sum(1)
    length = h.norm(dim=1)
    edge_on = along <= EDGE_ON * length
    m = torch.where(edge_on[:, None], 0.0, h / torch.where(edge_on, 1.0, along)[:, None])
    g = (ray**2).sum(1)
    uv = u_bounded * v_bounded
    p = torch.where(edge_on, 0.0, (v_bounded**2 + 1) * m[:, 0] - uv * m[:, 1] - u_bounded * m[:, 2])
    q = torch.where(edge_on, 0.0, (u_bounded**2 + 1) * m[:, 1] - uv * m[:, 0] - v_bounded * m[:, 2])
    distance = torch.stack([x, y, z], 1).norm(dim=1)
    slopes = torch.stack([distance / g * p / fx, distance / g * q / fy], 1)
    normals = torch.where(edge_on[:, None], 0.0, -h / torch.where(edge_on, 1.0, length)[:, None])

    # Blending, front to back; a Gaussian takes part where the transmittance before it is at least 1e-4.
    rows, columns = torch.meshgrid(torch.arange(height, **to) + 0.5, torch.arange(width, **to) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows], 2).reshape(-1, 2)
    total_abs = torch.zeros(len(means), 2, **to)
    transmittance = torch.ones_like(pixels[:, 0])
    color, normal = (torch.zeros(len(pixels), 3, **to) for _ in range(2))
    alpha_sum, depth_sum, median = (torch.zeros_like(transmittance) for _ in range(3))
    inverse_sum, square_sum, distortion = (torch.zeros_like(transmittance) for _ in range(3))
    order = torch.argsort(z.detach(), stable=True)
    for k in order[drawn[order]]:
        offsets = projected[k] - pixels
        if statistics is not None and statistics.want_abs and offsets.requires_grad:
            offsets = _Absolute.apply(offsets, total_abs[index[k]])
        power = -0.5 * (offsets * torch.linalg.solve(filtered[k], offsets.T).T).sum(1)
        alpha = (opacity[k] * power.exp()).clamp(max=MAX_ALPHA)
        taken = (alpha >= least_alpha[k]) & (transmittance >= MIN_TRANSMITTANCE)
        alpha = torch.where(taken, alpha, 0.0)
        weight = transmittance * alpha
        t = (distance[k] + offsets @ slopes[k]).clamp(min=near)
        # Sum over all pairs of this Gaussian with one in front of it: product of weights times (1/t - 1/t')**2.
        distortion = distortion + weight * (alpha_sum / t**2 - 2 * inverse_sum / t + square_sum)
        inverse_sum, square_sum = inverse_sum + weight / t, square_sum + weight / t**2
        color = color + weight[:, None] * colors[k]
        normal = normal + weight[:, None] * normals[k]
        alpha_sum = alpha_sum + weight
        depth_sum = depth_sum + weight * t
        median = torch.where(taken & (transmittance > 0.5), t, median)
        transmittance = transmittance - weight
    if background is not None:
        color = color + transmittance[:, None] * background
    cosine = 1 / (((columns - cx) / fx) ** 2 + ((rows - cy) / fy) ** 2 + 1).sqrt()
    empty = alpha_sum == 0
    depth = torch.where(empty, 0.0, depth_sum / torch.where(empty, 1.0, alpha_sum)).reshape(height, width) * cosine

    if statistics is not None:
        _fill(statistics, means, index, drawn, 3 * longest.sqrt(), projected, total_abs)
    outputs = (
        color.reshape(height, width, 3),
        alpha_sum.reshape(height, width),
        depth,
        median.reshape(height, width) * cosine,
        normal.reshape(height, width, 3),
        distortion.reshape(height, width) / cosine**2,
    )
    skipped = (4, 3, 1, 0)[geometry]
    return Raster(*outputs[: 6 - skipped], *[None] * skipped)


def _fill(
    statistics: ViewStatistics, means: Tensor, index: Tensor, drawn: Tensor, radii: Tensor, projected: Tensor,
    total_abs: Tensor,
) -> None:  # fmt: skip
    statistics.visible = torch.zeros(len(means), dtype=torch.bool, device=means.device)
    statistics.visible[index] = drawn
    statistics.radii = torch.zeros_like(means[:, 0]).detach()
    statistics.radii[index] = torch.where(drawn, radii, 0.0)
    if not projected.requires_grad:
        return

    def keep(gradient: Tensor) -> None:
        statistics.grad_2d = torch.zeros_like(total_abs)
        statistics.grad_2d[index] = torch.where(drawn[:, None], gradient, 0.0)
        if statistics.want_abs:
            statistics.abs_grad_2d = total_abs

    projected.register_hook(keep)
