"""The scatter on a GPU: float32, Triton, two forms with one result (see op.py).

Both forms take any aperture; "auto" chooses for each tile of pixels, on the device."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import ApertureShape
from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

from .op import STOP_OPACITY, in_threes, joined

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_TILE = {"TILE_Y": 8, "TILE_X": 32}
_WINDOWS = {"FINE": 4, "COARSE": 16}
_BLOCK = 512
_SUMS = 1024
_CHUNKS = 64
# A tile whose light comes from or goes at least this far, pixels, has the linear form. By instructions of the compiled
# kernels it is the shorter one, both ways together, from there on (docs/notes/gpu.md), which no GPU has confirmed.
_FROM = {"auto": 24.0, "direct": math.inf, "linear": 0.0}
_LARGEST_RADIUS = torch.finfo(torch.float32).tiny ** -0.5


def scatter(image, signed_radius, alpha, shape, area, form):
    groups = [_Scatter.apply(colours, signed_radius, alpha, shape, area, form) for colours in in_threes(image)]
    return joined(groups, image.shape[2])


class _Aperture(NamedTuple):
    """An aperture's shape as the kernels take it. factors: see `_factors`; those of a disc are never looked at.
    shortest: least factor. steepest: see `radii_through` (gpu_row_windows.py)."""

    shaped: bool
    factors: Tensor
    shortest: float
    steepest: float


def _aperture(shape: ApertureShape, image: Tensor) -> _Aperture:
    if shape.blades == 0 or shape.curvature == 1:
        return _Aperture(False, image, 1.0, 1.0)
    apothem = math.cos(math.pi / shape.blades)
    shortest = (1.0 - shape.curvature) * apothem + shape.curvature
    return _Aperture(True, _factors(shape, *image.shape[:2], image.device), shortest, 1.0 / apothem)


@lru_cache(maxsize=2)
def _factors(shape: ApertureShape, height: int, width: int, device: torch.device) -> Tensor:
    """(2 H - 1, 2 (W + margin) + 1): the aperture's radius towards every offset as a share of a corner's, offset (0, 0)
    in the middle; 1 there. Kept, since a training asks for one shape and size again and again."""
    margin = kernels("scatter.gpu_rim").MARGIN.value
    rows = np.arange(1 - height, height)[:, None]
    columns = np.arange(-width - margin, width + margin + 1)[None, :]
    factors = np.where((rows == 0) & (columns == 0), 1.0, shape.radius_factor(np.arctan2(rows, columns)))
    return torch.from_numpy(factors.astype(np.float32)).to(device)


def _brightness(image: Tensor, sums: Tensor) -> Tensor:
    """(3,) on the device: largest magnitude of the image, mean of those that are no highlights, largest radius. sums:
    (5, blocks), which `pack_sources` began."""
    direct = kernels("scatter.gpu_direct")
    size, blocks = image.shape[0] * image.shape[1], sums.shape[1]
    brightness = torch.empty(3, device=image.device)
    launch(direct.sum_usual, (blocks,), image, sums, size, blocks, BLOCK=_SUMS, PIXELS=_BLOCK)
    launch(direct.join_sums, (1,), sums, brightness, size, blocks, BLOCK=_SUMS)
    return brightness


def _regions(
    image: Tensor, radius: Tensor, bright: Tensor, farthest: Tensor, linear_from: float, lengths: tuple[float, ...]
) -> tuple[Tensor, Tensor]:
    """Bounds of the sources that tiles see through windows, fine and coarse: (4, H + tile - 1, columns) each."""
    windows = kernels("scatter.gpu_row_windows")
    height, width = radius.shape
    fine, coarse = _WINDOWS["FINE"], _WINDOWS["COARSE"]
    chunk_columns = -(-width // fine)
    chunks = torch.empty(4, height, chunk_columns, device=image.device)
    launch(
        windows.chunk_bounds, (height, -(-chunk_columns // _CHUNKS)), image, radius, bright, chunks, farthest,
        linear_from, width, chunk_columns, *lengths,
        FINE=fine, BLOCK=_CHUNKS,
    )  # fmt: skip
    bounds = []
    rows = height + _TILE["TILE_Y"] - 1
    before = _TILE["TILE_X"] + coarse
    for wide in (fine, coarse):
        columns = -(-(width + before) // coarse) * (coarse // wide)
        bounds.append(torch.empty(4, rows, columns, device=image.device))
        constants = {
            "FIRST": -before // fine,
            "STEP": wide // fine,
            "COUNT": (_TILE["TILE_X"] + wide) // fine,
            "TILE_Y": _TILE["TILE_Y"],
            "BLOCK": _CHUNKS,
        }
        sizes = height, chunk_columns, columns
        grid = rows, -(-columns // _CHUNKS)
        launch(windows.region_bounds, grid, chunks, bounds[-1], farthest, linear_from, *sizes, **constants)
    return bounds[0], bounds[1]


def _window_sums(values: Tensor, farthest: Tensor, linear_from: float) -> tuple[Tensor, Tensor]:
    """Sums of (4, H, W) over windows of a row, fine and coarse: (4, H, W + window - 1), by their first column."""
    windows = kernels("scatter.gpu_row_windows")
    _, height, width = values.shape
    sums, step = [], 1
    for wide in _WINDOWS.values():
        columns = width + wide - 1
        sums.append(torch.empty(4, height, columns, device=values.device))
        grid = 4 * height, -(-columns // _BLOCK)
        steps = {"STEP": step, "COUNT": wide // step, "BLOCK": _BLOCK}
        launch(windows.add_windows, grid, values, sums[-1], farthest, linear_from, values.shape[2], columns, **steps)
        values, step = sums[-1], wide
    return sums[0], sums[1]


class _Scatter(torch.autograd.Function):
    """The scatter of three channels at a time. Each tile has one of two forms, by how far its light comes from or goes,
    which is known on the device alone: the other form's program ends at once."""

    @staticmethod
    def forward(context, image, signed_radius, alpha, shape, area, form):
        direct = kernels("scatter.gpu_direct")
        height, width = signed_radius.shape
        size = height * width
        linear_from = _FROM[form]
        aperture = _aperture(shape, image)
        kind = {"SHAPED": aperture.shaped, "STOPPED": shape.obstruction > 0}
        planes = torch.empty(5, height, width, device=image.device)
        blocks = (-(-size // _BLOCK),)
        sums = torch.empty(5, *blocks, device=image.device)
        launch(
            direct.pack_sources, blocks, image, signed_radius, planes, sums, size, _LARGEST_RADIUS,
            AREA=area, BLOCK=_BLOCK,
        )  # fmt: skip
        tiles = -(-height // _TILE["TILE_Y"]), -(-width // _TILE["TILE_X"])
        reach = torch.empty(tiles, device=image.device)
        bounds = torch.empty(4, *tiles, device=image.device)
        window = torch.empty(tiles, dtype=torch.int32, device=image.device)
        stop = -math.log(1.0 - STOP_OPACITY) if shape.obstruction > 0 else 0.0
        bright = _brightness(image, sums)
        lengths = float(alpha), stop, aperture.shortest, float(shape.obstruction), _LARGEST_RADIUS
        launch(direct.tile_reach, tiles, image, signed_radius, bright, reach, bounds, height, width, *lengths, **_TILE)
        launch(direct.tile_window, (tiles[0] * tiles[1],), reach, window, *tiles, BLOCK=_BLOCK, **_TILE)
        farthest = window.amax()
        blurred, total = torch.empty_like(image), torch.empty_like(signed_radius)
        options = float(alpha), aperture.factors, float(shape.obstruction)
        if form != "linear":
            results = window, blurred, total, height, width, linear_from
            launch(direct.gather, tiles, planes, *results, *options, **kind, **_TILE)
        if form != "direct":
            regions = _regions(image, signed_radius, bright, farthest, linear_from, lengths)
            launch(
                kernels("scatter.gpu_linear").gather_windows, tiles, planes,
                *_window_sums(planes[1:], farthest, linear_from), *regions, window, blurred, total, height, width,
                regions[1].shape[2], linear_from, aperture.steepest, *options, **kind, **_TILE, **_WINDOWS,
            )  # fmt: skip
        context.save_for_backward(image, signed_radius, blurred, total, reach, bounds, farthest, aperture.factors)
        context.form, context.options, context.steepest = form, options, aperture.steepest
        context.kind = {"AREA": area} | kind
        return blurred

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        direct = kernels("scatter.gpu_direct")
        image, signed_radius, blurred, total, reach, bounds, farthest, _ = context.saved_tensors
        height, width = signed_radius.shape
        size = height * width
        linear_from = _FROM[context.form]
        targets = torch.empty(4, height, width, device=image.device)
        blocks = (-(-size // _BLOCK),)
        launch(direct.pack_targets, blocks, gradient.contiguous(), blurred, total, targets, size, BLOCK=_BLOCK)
        by_image, by_radius = torch.empty_like(image), torch.empty_like(signed_radius)
        tiles = tuple(reach.shape)
        results = image, signed_radius, by_image, by_radius, height, width, linear_from
        if context.form != "linear":
            launch(direct.gather_gradient, tiles, targets, reach, *results, *context.options, **context.kind, **_TILE)
        if context.form != "direct":
            launch(
                kernels("scatter.gpu_linear").gather_gradient_windows,
                tiles,
                targets,
                *_window_sums(targets, farthest, linear_from),
                reach,
                bounds,
                *results,
                context.steepest,
                *context.options,
                # Half of the pixels a thread, since a stop takes registers.
                warps=8 if context.kind["STOPPED"] else 4,
                **context.kind,
                **_TILE,
                **_WINDOWS,
            )
        return by_image, by_radius, None, None, None, None
