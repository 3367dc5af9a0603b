"""The definition of plane-sweep stereo: plain torch, any floating type; see op.py."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

from .op import CENTRE, FAR, FLOOR, UNKNOWN

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def stereo(reference: Tensor, sources: Tensor, maps: Tensor, disparities: Tensor, radius: int, best: int) -> Tensor:
    height, width = reference.shape
    side = 2 * radius + 1
    rows = torch.arange(-radius, height + radius, device=reference.device)
    columns = torch.arange(-radius, width + radius, device=reference.device)
    y, x = (pixels.to(reference.dtype) + 0.5 for pixels in (rows, columns))
    rows, columns = rows.clamp(0, height - 1), columns.clamp(0, width - 1)
    patch = reference[rows][:, columns] - CENTRE

    def mean(image: Tensor) -> Tensor:
        return torch.nn.functional.avg_pool2d(image[None, None], side, stride=1)[0, 0]

    own, own_variance = mean(patch), (mean(patch * patch) - mean(patch) ** 2).clamp_min(0) + FLOOR
    scores = []
    for disparity in disparities:
        found = []
        for source, matrix in zip(sources, maps, strict=True):
            u, v, w = (
                matrix[i, 0] * x + (matrix[i, 1] * y[:, None] + (matrix[i, 2] + matrix[i, 3] * disparity))
                for i in range(3)
            )
            warped, inside = _bilinear(source - CENTRE, u / w, v / w)
            inside = (inside & (w > 0))[radius:-radius, radius:-radius]
            other = mean(warped)
            variance = (mean(warped * warped) - other**2).clamp_min(0) + FLOOR
            score = (mean(patch * warped) - own * other) / (own_variance * variance).sqrt()
            found.append(torch.where(inside, score, -torch.inf))
        largest = torch.stack(found).topk(best, dim=0).values
        seen = largest > -torch.inf
        total = torch.where(seen, largest, 0).sum(0)
        scores.append(torch.where(seen.any(0), total / seen.sum(0).clamp_min(1), UNKNOWN))
    return torch.stack(scores, dim=-1)


def _bilinear(image: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Samples at image coordinates, with border pixels repeated outside, and whether the coordinates are inside."""
    height, width = image.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x = torch.nan_to_num(x - 0.5).clamp(0, width - 1)
    y = torch.nan_to_num(y - 0.5).clamp(0, height - 1)
    left, top = x.long().clamp(max=max(width - 2, 0)), y.long().clamp(max=max(height - 2, 0))
    right, bottom = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    x, y = x - left, y - top
    upper = image[top, left] + x * (image[top, right] - image[top, left])
    lower = image[bottom, left] + x * (image[bottom, right] - image[bottom, left])
    return upper + y * (lower - upper), inside


def upsample(scores: Tensor, coarse: Tensor, share: float) -> None:
    planes = torch.nn.functional.interpolate(coarse, scores.shape[2], mode="linear", align_corners=True)
    enlarged = torch.nn.functional.interpolate(
        planes.permute(2, 0, 1)[None], scores.shape[:2], mode="bilinear", align_corners=False
    )
    scores += share * (enlarged[0].permute(1, 2, 0) - scores)


def semiglobal(scores: Tensor, guide: Tensor, small: float, large: float, edge: float) -> tuple[Tensor, Tensor, Tensor]:
    height, width, count = scores.shape
    total = torch.zeros_like(scores)
    for axis, size in ((1, width), (0, height)):
        for order in (range(size), range(size - 1, -1, -1)):
            cost: Tensor | None = None
            before: Tensor | None = None
            for index in order:
                own = -scores.select(axis, index)
                grey = guide.select(axis, index)
                if cost is None or before is None:
                    cost = own
                else:
                    jump = (large / (1 + (grey - before).abs() / edge)).clamp_min(small)
                    lowest = cost.min(dim=-1, keepdim=True).values
                    padded = torch.nn.functional.pad(cost, (1, 1), value=torch.inf)
                    step = torch.minimum(padded[..., :-2], padded[..., 2:]) + small
                    way = torch.minimum(torch.minimum(cost, step), lowest + jump[..., None])
                    cost = own + way - lowest
                total.select(axis, index).add_(cost)
                before = grey
    least, winner = total.min(dim=-1)
    inner = winner.clamp(1, max(count - 2, 1))
    if count >= 3:
        left, middle, right = (total.gather(-1, (inner + k)[..., None])[..., 0] for k in (-1, 0, 1))
        curvature = left - 2 * middle + right
        shift = torch.where(curvature > 0, 0.5 * (left - right) / curvature, 0).clamp(-0.5, 0.5)
        shift = torch.where(inner == winner, shift, 0)
    else:
        shift = torch.zeros_like(least)
    near = (torch.arange(count, device=scores.device) - winner[..., None]).abs() <= FAR
    second = torch.where(near, torch.inf, total).min(dim=-1).values
    return winner + shift, scores.gather(-1, winner[..., None])[..., 0], (second - least) / 4


def returns(depth: Tensor, other: Tensor, there: Tensor, back: Tensor, pixels: float, share: float) -> Tensor:
    rows, columns = torch.meshgrid(
        *(torch.arange(size, dtype=there.dtype, device=depth.device) + 0.5 for size in depth.shape), indexing="ij"
    )

    def moved(matrix: Tensor, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        u, v, w = (z * (matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2]) + matrix[i, 3] for i in range(3))
        return u / w, v / w, w

    depth, other = depth.to(there.dtype), other.to(there.dtype)
    x, y, z = moved(there, columns, rows, depth)
    inside = (depth > 0) & (z > 0) & (x >= 0) & (y >= 0) & (x < other.shape[1]) & (y < other.shape[0])
    at = tuple(torch.where(inside, value, 0).long() for value in (y, x))
    found = torch.where(inside, other[at], 0)
    u, v, again = moved(back, x, y, found)
    near = ((u - columns) ** 2 + (v - rows) ** 2 < pixels**2) & ((again / depth - 1).abs() < share)
    return (found > 0) & (again > 0) & near
