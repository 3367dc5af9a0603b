"""Plane-sweep stereo for the CPU: `stereo`, `upsample`, `semiglobal`, `returns`; see `reference.py`.

Bands of rows (of columns for the vertical paths) run in parallel and write to separate places, so the number of threads
changes no bit. fastmath isn't used, for the reason given in `ssim/cpu_windows.py`.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.kernel_cache import cached, is_compiled
from dofbench.runtime.simd import LANES

from .cpu_paths import COLUMNS, along_rows, down_columns
from .cpu_returns import find_returns
from .cpu_sweep import sweep
from .reference import CENTRE, check

SCRATCH = 2**28  # largest number of bytes that semiglobal matching uses in addition to the scores
_F = np.float32
_ZERO, _ONE, _HALF = _F(0), _F(1), _F(0.5)


def stereo(reference: Tensor, sources: Tensor, maps: Tensor, disparities: Tensor, *, radius: int, best: int) -> Tensor:
    """Scores (H, W, D) of each pixel at each plane; see `reference.stereo`. float32 on the CPU.

    Raises ValueError for invalid arguments.
    """
    check(reference, sources, maps, disparities, radius, best)
    scores = np.empty((*reference.shape, len(disparities)), np.float32)
    single = [
        tensor.detach().to(torch.float32).contiguous().numpy() for tensor in (reference, sources, maps, disparities)
    ]
    single[0], single[1] = single[0] - _F(CENTRE), np.pad(single[1] - _F(CENTRE), ((0, 0), (0, 1), (0, 1)), "edge")
    sweep(*single, radius, (0,) * (2 * radius + 1), best, scores)
    return torch.from_numpy(scores)


@cached
@njit(parallel=True, error_model="numpy")
def _add(scores, coarse, share):
    height, width, count = scores.shape
    low, narrow, few = coarse.shape
    place, beyond = np.empty(count, np.int64), np.empty(count, np.float32)
    for k in range(count):
        at = k * (few - 1) / (count - 1) if count > 1 else 0.0
        place[k] = max(min(np.int64(at), few - 2), 0)
        beyond[k] = _F(at - place[k])
    for row in prange(height):
        y = max((_F(row) + _HALF) * _F(low) / _F(height) - _HALF, _ZERO)
        top = min(np.int64(y), low - 1)
        bottom = min(top + 1, low - 1)
        y -= _F(top)
        mixed = np.empty(few + 1, np.float32)
        for column in range(width):
            x = max((_F(column) + _HALF) * _F(narrow) / _F(width) - _HALF, _ZERO)
            left = min(np.int64(x), narrow - 1)
            right = min(left + 1, narrow - 1)
            x -= _F(left)
            a, b = (_ONE - y) * (_ONE - x), (_ONE - y) * x
            c, d = y * (_ONE - x), y * x
            for k in range(few):
                mixed[k] = (
                    a * coarse[top, left, k]
                    + b * coarse[top, right, k]
                    + c * coarse[bottom, left, k]
                    + d * coarse[bottom, right, k]
                )
            mixed[few] = mixed[few - 1]
            for k in range(count):
                other = mixed[place[k]] + beyond[k] * (mixed[place[k] + 1] - mixed[place[k]])
                scores[row, column, k] += share * (other - scores[row, column, k])


def upsample(scores: Tensor, coarse: Tensor, share: float) -> None:
    """Mix a coarser level's scores, enlarged, into scores (H, W, D), in place; see `reference.upsample`."""
    _add(scores.numpy(), coarse.contiguous().numpy(), _F(share))


def semiglobal(
    scores: Tensor, guide: Tensor, *, small: float, large: float, edge: float
) -> tuple[Tensor, Tensor, Tensor]:
    """(plane, score, margin), each (H, W); see `reference.semiglobal`. float32 on the CPU.

    It uses as much memory as the scores in addition to them, but at most SCRATCH: a large image is processed in blocks
    of columns, which changes no bit.
    """
    height, width, known = scores.shape
    volume = scores.contiguous()
    if known % LANES:
        # Padded with planes of infinite cost, which are never chosen.
        volume = torch.nn.functional.pad(volume, (0, -known % LANES), value=-torch.inf)
    shape = tuple(volume.shape)
    flat, grey = volume.numpy().reshape(-1), guide.detach().to(torch.float32).contiguous().numpy().reshape(-1)
    penalties = _F(small), _F(large), _F(edge)
    wide = min(width, max(COLUMNS, SCRATCH // (4 * height * shape[2]) // COLUMNS * COLUMNS))
    total = np.empty(height * wide * shape[2], np.float32)
    found = [np.empty(height * width, np.float32) for _ in range(3)]
    for left in range(0, width, wide):
        right = min(left + wide, width)
        along_rows(flat, grey, shape, *penalties, left, right, total)
        down_columns(flat, grey, shape, known, *penalties, left, right, total, *found)
    plane, score, margin = (torch.from_numpy(values.reshape(height, width)) for values in found)
    return plane, score, margin


def returns(depth: Tensor, other: Tensor, there: Tensor, back: Tensor, *, pixels: float, share: float) -> Tensor:
    """Where another view sees the same surface, (H, W) bool; see `reference.returns`. Coordinates are float64."""
    own, seen = (tensor.to(torch.float32).contiguous().numpy() for tensor in (depth, other))
    maps = [tensor.to(torch.float64).contiguous().numpy() for tensor in (there, back)]
    found = np.zeros(own.shape, np.bool_)
    find_returns(own, seen, *maps, float(pixels), float(share), found)
    return torch.from_numpy(found)


def _warm_up(radius: int = 3, best: int = 2) -> None:
    """Compile all four functions, the sweep for windows of this radius."""
    image = torch.rand((16, 16), generator=torch.Generator().manual_seed(0))
    ahead = torch.eye(3, 4, dtype=torch.float64)
    scores = stereo(
        image, torch.stack([image] * best), ahead.repeat(best, 1, 1), torch.linspace(0, 1, 3), radius=radius, best=best
    )
    upsample(scores, scores.clone(), 0.5)
    semiglobal(scores, image, small=0.1, large=0.5, edge=0.1)
    returns(image, image, ahead, ahead, pixels=1.0, share=0.1)


BACKEND = Backend(
    devices=("cpu",),
    dtypes=("float32",),
    bits_repeat=True,
    warm_up=_warm_up,
    is_warm=lambda: is_compiled(find_returns),
)
