"""`rasterize` on the CPU: numba kernels behind autograd functions; float32.

Stages: project (cpu_project), assign to tiles and sort (cpu_lists), blend (cpu_blend). The backward pass blends front
to back a second time, writes one small record per intersection of a Gaussian with a tile, and sums these records in a
fixed order (cpu_project_backward). It uses no atomics, so every run gives the same bits with any number of threads.

`rasterize_from_points` projects once: seen from a point p of the unit lens, a Gaussian with the signed circle of
confusion R lies R p pixels from where the lens's centre sees it, and its footprint, opacity and colour are those seen
from the centre. So projection, which takes more than half of the time where Gaussians are about as many as pixels, and
its gradient are computed once for all points; sorting into tiles and blending once for each point.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import torch
from torch.autograd.function import once_differentiable

from dofbench.core.cameras import Camera
from dofbench.runtime.kernel_cache import cpu_backend
from dofbench.runtime.simd import LANES

from . import cpu_layout as layout
from . import op
from .cpu_blend import blend, blend_backward
from .cpu_lists import fill_tiles
from .cpu_points import WIDTH, shift_records, times_point
from .cpu_project import project
from .cpu_project_backward import project_backward

# The level of geometry that each output belongs to.
_LEVELS = (0, 0, 1, 2, 2, 3)
_NOTHING = np.empty(0, np.float32)


def rasterize(parameters, blur, view, statistics):
    _check_blur(blur)
    return _Rasterize.apply(_Settings(view), statistics, blur, *parameters)


def rasterize_from_points(parameters, blur, radius, points, view, statistics):
    _check_blur(blur)
    lens = np.ascontiguousarray(points, dtype=np.float32)
    return _FromPoints.apply(_Settings(view), statistics, lens, blur, radius, *parameters)


def _check_blur(blur):
    if blur is not None and len(blur) and (least := float(blur.detach().min())) < 0:
        raise ValueError(f"blur: expected at least 0, found {least}")


class _Settings:
    """The arguments that aren't differentiated, in the form that the compiled stages need."""

    def __init__(self, view: op.View):
        self.degree, self.geometry = view.degree, view.geometry
        self.width, self.height = view.camera.width, view.camera.height
        self.columns, self.rows = -(-self.width // layout.TILE_WIDTH), -(-self.height // layout.TILE_HEIGHT)
        self.features = (0,) * view.geometry
        self.filter_3d = view.filter_3d
        self.background = np.zeros(3, np.float32) if view.background is None else view.background.numpy()
        constants = view.constants()
        self.view = np.zeros(layout.VIEW, np.float32)
        self.view[: layout.FADES] = constants[: layout.FADES]
        self.view[layout.FADES] = view.fades
        self.view[layout.U_LOW : layout.V_HIGH + 1] = constants[layout.FADES :]

    def tiles(self, records, depths, counts, n):
        """Every tile's list of Gaussians, see `fill_tiles`."""
        chunks = 4 * numba.get_num_threads()
        return fill_tiles(records, depths, counts, n, self.view, self.columns, self.rows, chunks)


def _flat(tensor):
    return _NOTHING if tensor is None else tensor.detach().numpy().reshape(-1)


def _whole_lines(size):
    """(size,) float32 from the beginning of a cache line on, so that a record that fills one is in one."""
    memory = np.empty(size + layout.RECORD, np.float32)
    first = -memory.ctypes.data // memory.itemsize % layout.RECORD
    return memory[first : first + size]


def _projected(settings, parameters, blur, radius, margin):
    """(records, depths, radii, visible, counts), see `project`. Raises FloatingPointError for a Gaussian that isn't
    finite."""
    padded = -(-parameters[0].shape[0] // LANES) * LANES
    records = _whole_lines(padded * layout.RECORD)
    depths, radii = np.empty(padded, np.float32), np.empty(padded, np.float32)
    outputs = records, depths, radii, np.empty(padded, np.bool_), np.empty(padded, np.int32)
    inputs = *map(_flat, (*parameters, settings.filter_3d, blur)), margin
    bad = project(inputs, parameters[5].shape[1], settings.degree, settings.geometry, settings.view, outputs)
    if bad >= 0:
        raise op.explain(bad, parameters, settings.filter_3d, blur, radius)
    return outputs


def _by_parameters(settings, statistics, saved, level, records, intersections, by_radius):
    """The gradients with respect to the six parameters and blur, from those of all intersections; fills in
    `statistics`.

    saved: the parameters and blur. intersections: see `project_backward`.
    """
    want_abs = statistics is not None and statistics.want_abs
    n, rest = saved[0].shape[0], saved[5].shape[1]
    # Allocated by numpy, which requests huge pages and torch doesn't: this makes the last stage a third faster at
    # 100 000 Gaussians.
    results = [np.empty(parameter.shape, np.float32) for parameter in saved]
    grad_2d = np.empty((n, 2) if statistics is not None else (0, 2), np.float32)
    abs_grad_2d = np.empty((n, 2) if want_abs else (0, 2), np.float32)
    inputs = *map(_flat, (*saved[:6], settings.filter_3d, saved[6])), _NOTHING
    outputs = *(result.reshape(-1) for result in results), by_radius, grad_2d.reshape(-1), abs_grad_2d.reshape(-1)
    project_backward(inputs, rest, settings.degree, level, settings.view, records, intersections, outputs)
    if statistics is not None:
        statistics.grad_2d = torch.from_numpy(grad_2d)
        if want_abs:
            statistics.abs_grad_2d = torch.from_numpy(abs_grad_2d)
    return [torch.from_numpy(result) for result in results]


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(context, settings, statistics, blur, *parameters):
        n = parameters[0].shape[0]
        records, depths, radii, visible, counts = _projected(settings, parameters, blur, None, _NOTHING)
        starts, ids, spans, offsets, places = settings.tiles(records, depths, counts, n)
        lists = starts, ids, spans

        def image(level, *channels):
            shape = (settings.height, settings.width, *channels) if settings.geometry >= level else 0
            return np.empty(shape, np.float32)

        color, alpha, depth, median, at = image(0, 3), image(0), image(1), image(2), image(2)
        images = color, alpha, depth, median, at, image(2, 3), image(3), image(3)
        normal, distortion, mean_inverse = images[5:]
        looked_at = np.empty(settings.columns * settings.rows, np.int32)
        flat = tuple(each.reshape(-1) for each in images)
        where = settings.view, settings.columns
        blend(
            settings.features, records, lists, *where, settings.background, flat, looked_at, 4 * numba.get_num_threads()
        )
        if statistics is not None:
            statistics.visible, statistics.radii = torch.from_numpy(visible[:n]), torch.from_numpy(radii[:n])
        outputs = [torch.from_numpy(each) for each in (color, alpha, depth, median, normal, distortion)]
        context.settings, context.statistics = settings, statistics
        context.kept = records, lists, (offsets[None], places), looked_at, at.reshape(-1), mean_inverse.reshape(-1)
        context.set_materialize_grads(False)
        context.save_for_backward(*parameters, torch.from_numpy(_NOTHING) if blur is None else blur, *outputs)
        return tuple(each if settings.geometry >= level else None for each, level in zip(outputs, _LEVELS, strict=True))

    @staticmethod
    def backward(context, *by_outputs):
        settings, statistics, saved = context.settings, context.statistics, context.saved_tensors
        color, alpha, depth, median, normal, distortion = (_flat(each) for each in saved[7:])
        records, lists, of_gaussians, looked_at, at, mean_inverse = context.kept
        images = color, alpha, depth, median, at, normal, distortion, mean_inverse
        by_images = tuple(_NOTHING if g is None else g.contiguous().numpy().reshape(-1) for g in by_outputs)
        # Gradients are computed only for the outputs that the loss uses.
        used = [level for array, level in zip(by_images, _LEVELS, strict=True) if array.size]
        features = settings.features[: max(used, default=0)]
        absolute = (0,) * (statistics is not None and statistics.want_abs)
        width = 24 if len(features) > 1 else 16
        gradients, blended = _whole_lines(lists[1].size * width), np.zeros(lists[1].size, np.uint8)
        blend_backward(
            features, absolute, records, lists, settings.view, settings.columns, looked_at, images, by_images,
            gradients, blended, 4 * numba.get_num_threads(),
        )  # fmt: skip
        intersections = gradients, width, blended, *of_gaussians, np.zeros(1, np.int64)
        *by_parameters, by_blur = _by_parameters(
            settings, statistics, saved[:7], len(features), records, intersections, _NOTHING
        )
        return None, None, by_blur if context.needs_input_grad[2] else None, *by_parameters


class _Tiles(NamedTuple):
    """The Gaussians as seen from one point of the lens, and the tiles' lists of them; see `fill_tiles`."""

    records: np.ndarray
    lists: tuple[np.ndarray, ...]
    offsets: np.ndarray
    places: np.ndarray
    looked_at: np.ndarray


class _FromPoints(torch.autograd.Function):
    @staticmethod
    def forward(context, settings, statistics, points, blur, radius, *parameters):
        n, moved = parameters[0].shape[0], radius.detach().numpy()
        farthest = np.float32(np.sqrt((points.astype(np.float64) ** 2).sum(axis=1).max()))
        margin = np.abs(moved) * farthest
        records, depths, radii, visible, _ = _projected(settings, parameters, blur, radius, margin)
        threads = numba.get_num_threads()
        color = np.empty((len(points), settings.height, settings.width, 3), np.float32)
        alpha = np.empty((len(points), settings.height, settings.width), np.float32)
        tiles, drawn = [], np.zeros(n, np.bool_)
        for number, (x, y) in enumerate(points):
            shifted, met = _whole_lines(records.size), np.empty(n, np.int32)
            shift_records(records, visible, moved, x, y, n, settings.view, shifted, met)
            drawn |= met > 0
            # The depths are the same from all points, which lie in one plane parallel to the image.
            *lists, offsets, places = settings.tiles(shifted, depths, met, n)
            looked_at = np.empty(settings.columns * settings.rows, np.int32)
            images = (color[number].reshape(-1), alpha[number].reshape(-1), *(_NOTHING,) * 6)
            where = settings.view, settings.columns
            blend((), shifted, tuple(lists), *where, settings.background, images, looked_at, 4 * threads)
            tiles.append(_Tiles(shifted, tuple(lists), offsets, places, looked_at))
        if statistics is not None:
            statistics.visible, statistics.radii = torch.from_numpy(drawn), torch.from_numpy(radii[:n])
        result = torch.from_numpy(color)
        context.settings, context.statistics, context.points, context.tiles = settings, statistics, points, tiles
        context.records = records
        kept_blur = torch.from_numpy(_NOTHING) if blur is None else blur
        context.save_for_backward(*parameters, kept_blur, result, torch.from_numpy(alpha))
        return result

    @staticmethod
    @once_differentiable
    def backward(context, by_images):
        settings, statistics, tiles, saved = context.settings, context.statistics, context.tiles, context.saved_tensors
        color, alpha = (each.detach().numpy() for each in saved[7:])
        by_color = by_images.contiguous().numpy()
        absolute = (0,) * (statistics is not None and statistics.want_abs)
        first = np.cumsum([0] + [one.places.size for one in tiles])
        gradients, blended = _whole_lines(first[-1] * WIDTH), np.zeros(first[-1], np.uint8)
        for number, (one, (x, y)) in enumerate(zip(tiles, context.points, strict=True)):
            part = gradients[first[number] * WIDTH : first[number + 1] * WIDTH]
            there = blended[first[number] : first[number + 1]]
            images = (color[number].reshape(-1), alpha[number].reshape(-1), *(_NOTHING,) * 6)
            gradient = (by_color[number].reshape(-1), *(_NOTHING,) * 5)
            blend_backward(
                (), absolute, one.records, one.lists, settings.view, settings.columns, one.looked_at, images, gradient,
                part, there, 4 * numba.get_num_threads(),
            )  # fmt: skip
            times_point(part, x, y)
        by_radius = np.empty(saved[0].shape[0], np.float32)
        offsets, places = np.stack([one.offsets for one in tiles]), np.concatenate([one.places for one in tiles])
        intersections = gradients, WIDTH, blended, offsets, places, first[:-1]
        *by_parameters, by_blur = _by_parameters(
            settings, statistics, saved[:7], 0, context.records, intersections, by_radius
        )
        _, _, _, wants_blur, wants_radius, *_ = context.needs_input_grad
        by_lens = by_blur if wants_blur else None, torch.from_numpy(by_radius) if wants_radius else None
        return None, None, None, *by_lens, *by_parameters


def _warm_up(**options) -> None:
    """Compile the stages for these options of `rasterize` (geometry, statistics)."""
    parameters = [torch.zeros(shape) for shape in ((8, 3), (8, 3), (8, 4), (8,), (8, 3), (8, 15, 3))]
    camera = Camera(16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4))
    parameters[0][:, 2] = 2.0
    raster = op.rasterize(*(parameter.requires_grad_() for parameter in parameters), camera=camera, **options)
    torch.stack([output.sum() for output in raster if output is not None]).sum().backward()


BACKEND = cpu_backend(_warm_up, project_backward)
