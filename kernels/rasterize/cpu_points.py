"""`rasterize_from_points` on the CPU: one scene as seen from several points of a lens, projected once.

Seen from a point p of the unit lens, a Gaussian with the signed circle of confusion R lies R p pixels from where the
lens's centre sees it. Its footprint, opacity and colour are those seen from the centre. So projection, which takes
more than half of the time where Gaussians are about as many as pixels, and its gradient are computed once for all
points; sorting into tiles and blending once for each point.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.kernel_cache import cached
from dofbench.runtime.raster import ViewStatistics
from dofbench.runtime.simd import LANES
from dofbench.runtime.simd_memory import load8, store8

from . import cpu_layout as layout
from .cpu_bin import count_tiles, depth_order, fill_tiles
from .cpu_blend import blend, blend_backward
from .cpu_blocks import CHUNKS
from .cpu_inputs import NOTHING, Settings, check, describe
from .cpu_project import project
from .cpu_project_backward import project_backward

_WIDTH = 16  # floats of an intersection's gradient: no normals
_EMPTY2 = np.empty((0, 0), np.float32)
_EMPTY3 = np.empty((0, 0, 3), np.float32)


def rasterize_from_points(
    means: Tensor,
    log_scales: Tensor,
    quaternions: Tensor,
    opacity_logits: Tensor,
    sh_dc: Tensor,
    sh_rest: Tensor,
    *,
    camera: Camera,
    points: np.ndarray,
    radius: Tensor,
    blur: Tensor | None = None,
    filter_3d: Tensor | None = None,
    sh_degree: int = 3,
    background: Tensor | None = None,
    filter_2d: float = 0.1,
    filter_2d_fades: bool = True,
    near: float = 0.2,
    statistics: ViewStatistics | None = None,
) -> Tensor:
    """(P, H, W, 3): N Gaussians as `camera` sees them from P points of its lens, composited over the background.

    points: (P, 2) on the unit lens, x right and y down. radius: (N,) float32, pixels, the signed circle of confusion of
    each Gaussian: from point p its mean lies at its projection + radius * p, while its footprint, opacity and colour
    are those seen from the lens's centre. Differentiable with respect to the first six arguments, blur and radius. The
    other arguments are those of `rasterize`. statistics: of all points together: `visible` is whether it is drawn from
    any of them, gradients are summed over them.

    Raises ValueError and FloatingPointError as `rasterize` does.
    """
    parameters = (means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest)
    check(parameters, filter_3d, background, blur, radius, "none", sh_degree, filter_2d, near)
    lens = np.ascontiguousarray(points, dtype=np.float32)
    if lens.ndim != 2 or lens.shape[1:] != (2,) or not len(lens):
        raise ValueError(f"points: expected shape (P, 2), P at least 1, found {lens.shape}")
    degree = min(sh_degree, math.isqrt(sh_rest.shape[1] + 1) - 1)
    settings = Settings(camera, degree, filter_2d, filter_2d_fades, near, 0, filter_3d, background)
    images: Tensor = _FromPoints.apply(settings, statistics, lens, blur, radius, *parameters)
    return images


class _Tiles(NamedTuple):
    """The tiles of one lens point, kept for the backward pass."""

    records: np.ndarray
    starts: np.ndarray
    ids: np.ndarray
    spans: np.ndarray
    offsets: np.ndarray
    places: np.ndarray
    looked_at: np.ndarray


class _FromPoints(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        settings: Settings,
        statistics: ViewStatistics | None,
        points: np.ndarray,
        blur: Tensor | None,
        radius: Tensor,
        *parameters: Tensor,
    ) -> Tensor:
        n, rest = parameters[0].shape[0], parameters[5].shape[1]
        flat = [parameter.detach().numpy().reshape(-1) for parameter in parameters]
        variance = NOTHING if blur is None else blur.detach().numpy()
        moved = radius.detach().numpy()
        padded = -(-n // LANES) * LANES
        records = np.empty(padded * layout.RECORD, np.float32)
        depths, radii = np.empty(padded, np.float32), np.empty(padded, np.float32)
        visible, counts = np.empty(padded, np.bool_), np.empty(padded, np.int32)
        farthest = np.float32(np.sqrt((points.astype(np.float64) ** 2).sum(axis=1).max()))
        bad = project(
            *flat,
            rest,
            settings.filter_3d,
            variance,
            np.abs(moved) * farthest,
            settings.degree,
            0,
            settings.view,
            records,
            depths,
            radii,
            visible,
            counts,
        )
        if bad >= 0:
            if not np.isfinite(moved[bad]):
                raise FloatingPointError(f"radius[{bad}]: found {moved[bad]}, expected a finite number")
            raise FloatingPointError(describe(bad, parameters, settings.filter_3d, variance))
        # The order of depth is the same from all points, as they lie in one plane parallel to the image.
        order = depth_order(depths, counts, n)
        threads = numba.get_num_threads()
        height, width = settings.height, settings.width
        color = np.empty((len(points), height, width, 3), np.float32)
        alpha = np.empty((len(points), height, width), np.float32)
        tiles, drawn = [], np.zeros(n, np.bool_)
        for number, (x, y) in enumerate(points):
            shifted, met = np.empty_like(records), np.empty(n, np.int32)
            shift_records(records, visible, moved, x, y, n, settings.view, shifted, met)
            drawn |= met > 0
            starts, ids, spans, offsets, places = fill_tiles(
                shifted, met, n, order, settings.view, settings.columns, settings.rows, threads
            )
            looked_at = np.empty(settings.columns * settings.rows, np.int32)
            blend(
                (),
                shifted,
                starts,
                ids,
                spans,
                settings.view,
                settings.columns,
                settings.background,
                color[number].reshape(-1),
                alpha[number].reshape(-1),
                *(image.reshape(-1) for image in (_EMPTY2, _EMPTY2, _EMPTY2, _EMPTY3, _EMPTY2, _EMPTY2)),
                looked_at,
                4 * threads,
            )
            tiles.append(_Tiles(shifted, starts, ids, spans, offsets, places, looked_at))
        if statistics is not None:
            statistics.visible = torch.from_numpy(drawn)
            statistics.radii = torch.from_numpy(radii[:n])
        images = torch.from_numpy(color)
        ctx.settings, ctx.statistics, ctx.points, ctx.tiles = settings, statistics, points, tiles
        ctx.records = records
        ctx.save_for_backward(
            *parameters, torch.from_numpy(variance) if blur is None else blur, images, torch.from_numpy(alpha)
        )
        return images

    @staticmethod
    def backward(ctx: Any, by_images: Tensor) -> tuple[Tensor | None, ...]:
        settings, statistics, tiles = ctx.settings, ctx.statistics, ctx.tiles
        saved = [tensor.detach().numpy() for tensor in ctx.saved_tensors]
        parameters, blur, (color, alpha) = [array.reshape(-1) for array in saved[:6]], saved[6], saved[7:]
        by_color = by_images.contiguous().numpy()
        want_abs = statistics is not None and statistics.want_abs
        threads = numba.get_num_threads()
        first = np.cumsum([0] + [one.ids.size for one in tiles])
        gradients = np.empty(first[-1] * _WIDTH, np.float32)
        for number, (one, (x, y)) in enumerate(zip(tiles, ctx.points, strict=True)):
            part = gradients[first[number] * _WIDTH : first[number + 1] * _WIDTH]
            blend_backward(
                (),
                (0,) * want_abs,
                one.records,
                one.starts,
                one.ids,
                one.spans,
                settings.view,
                settings.columns,
                one.looked_at,
                color[number].reshape(-1),
                alpha[number].reshape(-1),
                *(image.reshape(-1) for image in (_EMPTY2, _EMPTY3, _EMPTY2, _EMPTY2, _EMPTY2)),
                by_color[number].reshape(-1),
                *(NOTHING,) * 5,
                part,
                4 * threads,
            )
            times_point(part, x, y)
        n, rest = parameters[3].size, ctx.saved_tensors[5].shape[1]
        offsets, places = join_places(
            np.stack([one.offsets for one in tiles]),
            np.concatenate([one.places + np.int32(start) for one, start in zip(tiles, first, strict=False)]),
            first,
        )
        results = [np.empty(array.shape, np.float32) for array in saved[:7]]
        by_radius = np.empty(n, np.float32)
        grad_2d = np.empty((n, 2) if statistics is not None else (0, 2), np.float32)
        abs_grad_2d = np.empty((n, 2) if want_abs else (0, 2), np.float32)
        flat = (*(result.reshape(-1) for result in results), by_radius)
        project_backward(
            *parameters,
            rest,
            settings.filter_3d,
            blur,
            settings.degree,
            0,
            settings.view,
            ctx.records,
            gradients,
            _WIDTH,
            offsets,
            places,
            (*flat, grad_2d.reshape(-1), abs_grad_2d.reshape(-1)),
        )
        if statistics is not None:
            statistics.grad_2d = torch.from_numpy(grad_2d)
            if want_abs:
                statistics.abs_grad_2d = torch.from_numpy(abs_grad_2d)
        *by_parameters, by_blur = (torch.from_numpy(result) for result in results)
        needed = ctx.needs_input_grad
        return (
            None,
            None,
            None,
            by_blur if needed[3] else None,
            torch.from_numpy(by_radius) if needed[4] else None,
            *by_parameters,
        )


@cached
@njit(parallel=True, error_model="numpy")
def shift_records(records, visible, radius, x, y, n, view, shifted, counts):
    """The records as seen from the lens point (x, y), and the number of tiles that each Gaussian meets from there."""
    for chunk in prange(CHUNKS):
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            counts[i] = 0
            if visible[i]:
                base = i * layout.RECORD
                store8(shifted, base, load8(records, base))
                store8(shifted, base + LANES, load8(records, base + LANES))
                shifted[base + layout.MX] += radius[i] * x
                shifted[base + layout.MY] += radius[i] * y
                counts[i] = count_tiles(shifted, i, view)


@cached
@njit(parallel=True, error_model="numpy")
def times_point(gradients, x, y):
    """Write the products of every intersection's moments with the lens point (x, y) to its S_POINT_* places."""
    intersections = gradients.size // _WIDTH
    for chunk in prange(CHUNKS):
        for k in range(chunk * intersections // CHUNKS, (chunk + 1) * intersections // CHUNKS):
            base = k * _WIDTH
            by_x, by_y = gradients[base + layout.QX], gradients[base + layout.QY]
            gradients[base + layout.S_POINT_XX] = x * by_x
            gradients[base + layout.S_POINT_XY] = x * by_y + y * by_x
            gradients[base + layout.S_POINT_YY] = y * by_y


@cached
@njit(parallel=True, error_model="numpy")
def join_places(offsets, places, first):
    """One list of places a Gaussian, over all lens points, in the order of the points.

    offsets: (P, N + 1), those of each point; places: (total,), all points' one after the other; first: (P + 1,), where
    each point's begin. Returns joined offsets (N + 1,) and places (total,).
    """
    points, n = offsets.shape[0], offsets.shape[1] - 1
    joined, order = np.empty(n + 1, np.int32), np.empty_like(places)
    for chunk in prange(CHUNKS):
        for i in range(chunk * (n + 1) // CHUNKS, (chunk + 1) * (n + 1) // CHUNKS):
            before = 0
            for p in range(points):
                before += offsets[p, i]
            joined[i] = before
            if i < n:
                for p in range(points):
                    for k in range(offsets[p, i], offsets[p, i + 1]):
                        order[before] = places[first[p] + k]
                        before += 1
    return joined, order
