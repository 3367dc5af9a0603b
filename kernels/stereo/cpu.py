"""Plane-sweep stereo for the CPU: `stereo`, `upsample`, `semiglobal`, `returns`; see op.py.

Bands of rows (of columns for the vertical paths) run in parallel and write to separate places, so the number of threads
changes no bit. fastmath isn't used, for the reason given in `ssim/cpu_windows.py`.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend
from dofbench.runtime.simd import LANES

from . import op
from .cpu_paths import COLUMNS, along_rows, down_columns
from .cpu_sweep import sweep
from .op import CENTRE

SCRATCH = 2**28  # largest number of bytes that semiglobal matching uses in addition to the scores
_F = np.float32
_ZERO, _ONE, _HALF = _F(0), _F(1), _F(0.5)


def stereo(reference, sources, maps, disparities, radius, best):
    scores = np.empty((*reference.shape, len(disparities)), np.float32)
    single = [tensor.to(torch.float32).contiguous().numpy() for tensor in (reference, sources, maps, disparities)]
    single[0], single[1] = single[0] - _F(CENTRE), np.pad(single[1] - _F(CENTRE), ((0, 0), (0, 1), (0, 1)), "edge")
    sweep(*single, radius, (0,) * (2 * radius + 1), best, scores)
    return torch.from_numpy(scores)


@cached
@njit(parallel=PRANGE, error_model="numpy")
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


def upsample(scores, coarse, share):
    _add(scores.numpy(), coarse.numpy(), _F(share))


def semiglobal(scores, guide, small, large, edge):
    # At most SCRATCH bytes besides the scores: a large image is processed in blocks of columns, which changes no bit.
    height, width, known = scores.shape
    volume = scores
    if known % LANES:
        # Padded with planes of infinite cost, which are never chosen.
        volume = torch.nn.functional.pad(volume, (0, -known % LANES), value=-torch.inf)
    shape = tuple(volume.shape)
    flat, grey = volume.numpy().reshape(-1), guide.numpy().reshape(-1)
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


def returns(depth, other, there, back, pixels, share):
    found = np.zeros(depth.shape, np.bool_)
    maps = (matrix.contiguous().numpy() for matrix in (there, back))
    _find_returns(depth.numpy(), other.numpy(), *maps, float(pixels), float(share), found)
    return torch.from_numpy(found)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _find_returns(depth, other, there, back, pixels, share, found):
    """Set found (H, W), initially False, to True where the other view sees the same surface; there, back: (3, 4)
    float64."""
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            z = np.float64(depth[row, column])
            if z <= 0:
                continue
            x, y = column + 0.5, row + 0.5
            w = z * (there[2, 0] * x + there[2, 1] * y + there[2, 2]) + there[2, 3]
            if w <= 0:
                continue
            u = (z * (there[0, 0] * x + there[0, 1] * y + there[0, 2]) + there[0, 3]) / w
            v = (z * (there[1, 0] * x + there[1, 1] * y + there[1, 2]) + there[1, 3]) / w
            if not (u >= 0 and v >= 0 and u < other.shape[1] and v < other.shape[0]):
                continue
            w = np.float64(other[int(v), int(u)])
            if w <= 0:
                continue
            again = w * (back[2, 0] * u + back[2, 1] * v + back[2, 2]) + back[2, 3]
            if again <= 0 or not abs(again / z - 1) < share:
                continue
            x -= (w * (back[0, 0] * u + back[0, 1] * v + back[0, 2]) + back[0, 3]) / again
            y -= (w * (back[1, 0] * u + back[1, 1] * v + back[1, 2]) + back[1, 3]) / again
            if x * x + y * y < pixels * pixels:
                found[row, column] = True


def _warm_up(radius: int = 3, best: int = 2) -> None:
    """Compile all four functions, the sweep for windows of this radius."""
    image = torch.rand((16, 16), generator=torch.Generator().manual_seed(0))
    ahead, planes = torch.eye(3, 4, dtype=torch.float64), torch.linspace(0, 1, 3)
    scores = op.stereo(image, torch.stack([image] * best), ahead.repeat(best, 1, 1), planes, radius=radius, best=best)
    op.upsample(scores, scores.clone(), 0.5)
    op.semiglobal(scores, image, small=0.1, large=0.5, edge=0.1)
    op.returns(image, image, ahead, ahead, pixels=1.0, share=0.1)


BACKEND = cpu_backend(_warm_up, _find_returns)
