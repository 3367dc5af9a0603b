"""The radiance field on a CPU: float32, numba, one autograd function; see op.py."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit, prange

from dofbench.runtime.factored_grid import FieldRender, GridShape, RaySamples
from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend, internal
from dofbench.runtime.simd import LANES, sums8
from dofbench.runtime.simd_functions import floor_int
from dofbench.runtime.simd_memory import store8

from . import cpu_grids, cpu_rays, op
from .cpu_rays import KEPT, RAYS_PER_TASK, WEIGHT, feature_lanes, softplus8
from .cpu_stencil import ONE, ZERO, product8, stencil

_POINTS_PER_TASK = 1024
_RAYS_PER_TASK = 64


def field(density, colour, basis, origins, directions, views, places, lengths, starts, shape, shift, least_weight):
    size = len(places)
    if int(starts[0]) != 0 or int(starts[-1]) != size or bool((starts.diff() < 0).any()):
        raise ValueError(f"field starts: expected numbers that rise from 0 to {size}")
    _check_finite(origins=origins, directions=directions, places=places)
    constants = np.float32(shift), np.float32(least_weight)
    inputs = density, colour, basis, origins, directions, views, starts, places, lengths
    found = _Field.apply(*inputs, shape, constants)
    return FieldRender(color=found[:, :3], opacity=found[:, 3], distance=found[:, 4])


def field_density(density, points, shape, shift):
    flat, places = density.detach().numpy(), points.detach().contiguous().numpy()
    found = np.empty(-(-len(places) // LANES) * LANES, np.float32)
    if len(places):
        grid = shape.nodes, shape.offsets(shape.density_rank), shape.density_rank
        _densities(flat, places, *grid, np.float32(shift), found)
    return torch.from_numpy(found[: len(places)])


def field_features(density, colour, points, shape):
    _check_finite(points=points)
    return _Features.apply(density, colour, points, shape)


def field_samples(origins, directions, spans, offsets, occupied, count):
    _check_finite(origins=origins, directions=directions, spans=spans)
    *rays, cells = (tensor.numpy() for tensor in (origins, directions, spans, offsets, occupied))
    starts, nothing = np.zeros(len(origins) + 1, np.int64), np.empty(0, np.float32)
    _march(*rays, cells, count, starts, nothing, nothing, False)
    starts = np.cumsum(starts)
    places, steps = np.empty(starts[-1], np.float32), np.empty(starts[-1], np.float32)
    _march(*rays, cells, count, starts, places, steps, True)
    return RaySamples(*(torch.from_numpy(array) for array in (starts, places, steps)))


def _check_finite(**tensors):
    """Raise FloatingPointError for a point that isn't finite, which has no node next to it."""
    for name, tensor in tensors.items():
        if not bool(torch.isfinite(tensor).all()):
            raise FloatingPointError(f"{name}: expected finite numbers")


class _Field(torch.autograd.Function):
    """(R, 5): colour, opacity and distance."""

    @staticmethod
    def forward(context, density, colour, basis, origins, directions, views, starts, places, lengths, shape, constants):
        grids = density.numpy(), colour.numpy(), basis.T.contiguous().numpy().reshape(-1)
        rays = tuple(rows.contiguous().numpy() for rows in (origins, directions, views))
        samples = starts.numpy(), places.numpy(), lengths.numpy()
        ranks = shape.density_rank, shape.colour_rank
        sizes = (shape.nodes, shape.offsets(ranks[0]), ranks[0], shape.offsets(ranks[1]), ranks[1], shape.harmonics)
        kept, seen = np.empty((len(places), KEPT), np.float32), np.empty(len(origins), np.int64)
        results = np.empty((len(origins), 5), np.float32)
        cpu_rays.render(grids, rays, samples, sizes, constants, kept, seen, results)
        context.save_for_backward(density, colour, basis)
        context.kept = grids, rays, samples, sizes, constants, kept, seen
        return torch.from_numpy(results)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        context.saved_tensors  # noqa: B018 (raises if one was changed in place)
        grids, rays, samples, sizes, constants, kept, seen = context.kept
        nodes, density_at, density_rank, colour_at, colour_rank, terms = sizes
        (starts, places, _), origins = samples, rays[0]
        wanted = any(context.needs_input_grad[3:6])
        ray_of = np.repeat(np.arange(len(origins)), np.diff(starts))
        counted = np.arange(len(places)) - starts[ray_of] < seen[ray_of]
        has_colour = counted & (kept[:, WEIGHT] >= constants[1])
        lit_from = np.concatenate([[0], np.cumsum(has_colour)])[starts]
        lit = np.empty(lit_from[-1], np.int64)
        by_feature = np.empty(len(places), np.float32)
        by_channels = np.empty((len(lit), 3 * colour_rank), np.float32)
        tasks = -(-len(origins) // RAYS_PER_TASK)
        by_basis = np.empty((tasks, grids[2].size), np.float32)
        by_rays = np.empty((len(origins), 9), np.float32)
        outputs = by_feature, lit, by_channels, by_basis, by_rays
        cpu_rays.backward(
            grids, rays, samples, sizes, constants, kept, seen, gradient.contiguous().numpy(), lit_from, wanted, outputs
        )
        numbers = np.flatnonzero(counted)
        of_ray = ray_of, rays[0], rays[1], places
        by_density = _spread(
            grids[0], _points(numbers, *of_ray), by_feature[numbers], 0, nodes, density_at, density_rank
        )
        by_colour = _spread(
            grids[1], _points(lit, *of_ray), by_channels.reshape(-1), colour_rank, nodes, colour_at, colour_rank
        )
        summed = torch.from_numpy(by_basis.sum(axis=0).reshape(3 * terms, -1).T.copy())
        of_rays = (torch.from_numpy(by_rays[:, 3 * k : 3 * k + 3].copy()) if wanted else None for k in range(3))
        return (torch.from_numpy(by_density), torch.from_numpy(by_colour), summed, *of_rays, *[None] * 5)


class _Features(torch.autograd.Function):
    """(P, C)."""

    @staticmethod
    def forward(context, density, colour, points, shape):
        places = points.contiguous()
        context.save_for_backward(density, colour, places)
        context.shape = shape
        found = np.empty((len(places), shape.feature_count), np.float32)
        for flat, (rank, first) in zip((density, colour), shape.feature_columns, strict=True):
            _products(flat.numpy(), places.numpy(), shape.nodes, shape.offsets(rank), rank, first, found)
        return torch.from_numpy(found)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        *grids, points = context.saved_tensors
        shape, found = context.shape, []
        for flat, (rank, first) in zip(grids, shape.feature_columns, strict=True):
            upstream = gradient[:, first : first + 3 * rank].contiguous().numpy().reshape(-1)
            grid = shape.nodes, shape.offsets(rank), rank
            found.append(torch.from_numpy(_spread(flat.numpy(), points.numpy(), upstream, rank, *grid)))
        return *found, None, None


def _points(numbers, ray_of, origins, directions, places) -> np.ndarray:
    """Where the samples of these numbers lie."""
    points = np.empty((len(numbers), 3), np.float32)
    cpu_grids.points_of(numbers, ray_of, origins, directions, places, points)
    return points


def _spread(flat, points, by_channels, step, nodes, offsets, rank) -> np.ndarray:
    """The gradient by `flat`; see `cpu_grids.spread`."""
    result = np.empty_like(flat)
    lines = np.empty((cpu_grids.BANDS, flat.size - offsets[3]), np.float32)
    cpu_grids.spread(flat, points, by_channels, step, nodes, offsets, rank, result, lines)
    return result


@internal(forceinline=True)
def _point_lanes(flat, points, p, nodes, offsets, rank):
    q = min(p, len(points) - 1)
    return feature_lanes(flat, points[q, 0], points[q, 1], points[q, 2], nodes, offsets, rank)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _densities(flat, points, nodes, offsets, rank, shift, found):
    for task in prange(-(-len(points) // _POINTS_PER_TASK)):
        for p in range(task * _POINTS_PER_TASK, min(len(points), (task + 1) * _POINTS_PER_TASK), LANES):
            total = sums8(
                _point_lanes(flat, points, p, nodes, offsets, rank),
                _point_lanes(flat, points, p + 1, nodes, offsets, rank),
                _point_lanes(flat, points, p + 2, nodes, offsets, rank),
                _point_lanes(flat, points, p + 3, nodes, offsets, rank),
                _point_lanes(flat, points, p + 4, nodes, offsets, rank),
                _point_lanes(flat, points, p + 5, nodes, offsets, rank),
                _point_lanes(flat, points, p + 6, nodes, offsets, rank),
                _point_lanes(flat, points, p + 7, nodes, offsets, rank),
            )
            value, _ = softplus8(total + shift)
            store8(found, p, value)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _products(flat, points, nodes, offsets, rank, first, found):
    """Fill the columns of found (P, C) from `first` on."""
    for task in prange(-(-len(points) // _POINTS_PER_TASK)):
        for p in range(task * _POINTS_PER_TASK, min(len(points), (task + 1) * _POINTS_PER_TASK)):
            modes = stencil(points[p, 0], points[p, 1], points[p, 2], nodes, offsets, rank)
            row = found[p]
            for channel in range(0, rank, LANES):
                for number, mode in enumerate(modes):
                    store8(row, first + number * rank + channel, product8(flat, mode, rank, channel))


@internal(forceinline=True)
def _cell(coordinate, cells):
    return min(floor_int(min(max(coordinate, ZERO), ONE) * np.float32(cells)), cells - 1)


@internal(forceinline=True)
def _is_occupied(occupied, origins, directions, ray, place):
    depth, height, width = occupied.shape
    x = _cell(origins[ray, 0] + place * directions[ray, 0], width)
    y = _cell(origins[ray, 1] + place * directions[ray, 1], height)
    z = _cell(origins[ray, 2] + place * directions[ray, 2], depth)
    return occupied[z, y, x]


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _march(origins, directions, spans, offsets, occupied, count, starts, places, steps, fill):
    """First with fill False: starts[r + 1] becomes the number of ray r's samples. Then, with starts added up, with fill
    True: places and steps are filled."""
    rays = len(origins)
    for task in prange(-(-rays // _RAYS_PER_TASK)):
        for ray in range(task * _RAYS_PER_TASK, min(rays, (task + 1) * _RAYS_PER_TASK)):
            begin = spans[ray, 0]
            step = (spans[ray, 1] - begin) / np.float32(count)
            found = 0
            if step > ZERO:
                for k in range(count):
                    place = begin + (np.float32(k) + offsets[ray]) * step
                    if _is_occupied(occupied, origins, directions, ray, place):
                        if fill:
                            places[starts[ray] + found], steps[starts[ray] + found] = place, step
                        found += 1
            if not fill:
                starts[ray + 1] = found


def _warm_up(**_options: Any) -> None:
    shape = GridShape((2, 2, 2), 8, 8, 1)
    random = torch.Generator().manual_seed(0)
    density = torch.rand(shape.density_size, generator=random).requires_grad_()
    colour, basis = (torch.rand(size, generator=random) for size in ((shape.colour_size,), shape.basis_shape))
    rays, starts, places = torch.rand((1, 3), generator=random), torch.tensor([0, 1]), torch.zeros(1)
    seen = op.field(density, colour, basis, rays, rays, rays, starts, places, places + 1, shape=shape, shift=0.0)
    (seen.color.sum() + seen.opacity.sum()).backward()
    op.field_density(density, rays, shape=shape, shift=0.0)
    op.field_features(density, colour, rays, shape=shape)
    cells = torch.ones((1, 1, 1), dtype=torch.bool)
    op.field_samples(rays, rays, torch.zeros((1, 2)), places, cells, count=1)


BACKEND = cpu_backend(_warm_up, cpu_grids.spread, _densities, _products, _march)
