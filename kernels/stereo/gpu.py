"""Plane-sweep stereo on a GPU: float32, Triton; see op.py."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

from .op import CENTRE, FLOOR

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
SCRATCH = 2**26  # bytes for the sums of the planes that are swept together: about as much as a GPU's cache holds
_LARGEST_GRID = 65535  # programs along the second and the third axis of a launch
_ROWS = 32  # of a strip, above which the first rows of its windows are warped once more
_BLOCK = 128
_COSTS = 512  # of pixels times planes, in a program that chooses planes
_PLANES_OF_A_WARP = 128  # four in a thread


def stereo(reference, sources, maps, disparities, radius, best):
    sweep = kernels("stereo.gpu_sweep")
    (height, width), (source_count, source_height, source_width) = reference.shape, sources.shape
    own, others = (reference - CENTRE).contiguous(), (sources - CENTRE).contiguous()
    mean, deviation = _statistics(own, radius)
    homographies = _homographies(maps.double(), disparities.double()).float()
    count, wide = len(disparities), width + 2 * radius
    scores = torch.empty(height, width, count, device=own.device)
    together = max(1, min(_LARGEST_GRID // source_count, SCRATCH // (4 * 3 * source_count * height * wide)))
    sums = torch.empty(min(together, count), source_count, 3, height, wide, device=own.device)
    sizes = height, width, source_count, source_height, source_width
    for first in range(0, count, together):
        planes = min(together, count - first)
        matrices = homographies[first : first + planes]
        strips = -(-wide // _BLOCK), -(-height // _ROWS), planes * source_count
        launch(sweep.sum_down, strips, own, others, matrices, sums, *sizes, RADIUS=radius, ROWS=_ROWS, BLOCK=_BLOCK)
        blocks = -(-height * width // _BLOCK), planes
        launch(
            sweep.correlate, blocks, sums, matrices, mean, deviation, scores[..., first:], count, *sizes,
            RADIUS=radius, BEST=best, BLOCK=_BLOCK,
        )  # fmt: skip
    return scores


def _statistics(own: Tensor, radius: int) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (H, W) under the window, summed in float64 so that flat windows lose no digits."""
    padded = torch.nn.functional.pad(own.double()[None, None], (radius,) * 4, mode="replicate")
    side = 2 * radius + 1
    mean, squares = (torch.nn.functional.avg_pool2d(one, side, stride=1)[0, 0] for one in (padded, padded.square()))
    return mean.float(), ((squares - mean.square()).clamp_min(0) + FLOOR).sqrt().float()


def _homographies(maps: Tensor, disparities: Tensor) -> Tensor:
    """(D, S, 3, 3): the matrix that takes (x, y, 1) to a source, for each plane."""
    found = maps[:, :, :3].expand(len(disparities), -1, -1, -1).clone()
    found[..., 2] += maps[:, :, 3] * disparities[:, None, None]
    return found


def upsample(scores, coarse, share):
    (height, width, count), mixed = scores.shape, scores.contiguous()
    grid = -(-width * count // _BLOCK), height
    launch(
        kernels("stereo.gpu_pixels").add_coarse, grid, mixed, coarse, float(share),
        height, width, count, *coarse.shape, BLOCK=_BLOCK,
    )  # fmt: skip
    if not scores.is_contiguous():
        scores.copy_(mixed)


def semiglobal(scores, guide, small, large, edge):
    paths = kernels("stereo.gpu_paths")
    height, width, count = scores.shape
    total = torch.empty_like(scores)
    planes = 1 << (count - 1).bit_length()
    last, penalties = height * width - 1, (float(small), float(large), float(edge))
    # (number of paths, pixels of one, first pixel, step to the next path, step along it)
    directions = (
        (height, width, 0, width, 1),
        (height, width, last, -width, -1),
        (width, height, 0, 1, width),
        (width, height, last, -1, -width),
    )
    for index, (number, *path) in enumerate(directions):
        launch(
            paths.add_path, (number,), scores, guide, total, count, *path, *penalties,
            warps=max(1, planes // _PLANES_OF_A_WARP), FIRST=index == 0, PLANES=planes,
        )  # fmt: skip
    found = torch.empty(3, height, width, device=scores.device)
    pixels = max(1, _COSTS // planes)
    grid = (-(-height * width // pixels),)
    launch(paths.choose, grid, total, scores, *found, height * width, count, PIXELS=pixels, PLANES=planes)
    plane, score, margin = found
    return plane, score, margin


def returns(depth, other, there, back, pixels, share):
    found = torch.empty(depth.shape, dtype=torch.bool, device=depth.device)
    matrices = [matrix.contiguous() for matrix in (there, back)]
    # Triton passes numbers on as float32, tensors as they are.
    limits = torch.stack([matrices[0].new_full((), limit) for limit in (pixels**2, share)])
    grid = (-(-depth.numel() // _BLOCK),)
    launch(
        kernels("stereo.gpu_pixels").find_returns, grid, depth, other, *matrices, limits,
        found, *depth.shape, *other.shape, BLOCK=_BLOCK,
    )  # fmt: skip
    return found
