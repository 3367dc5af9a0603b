"""The radiance field on a GPU: Triton kernels behind one autograd function; float32. See op.py.

Forward: every sample's optical depth (gpu_points), weights along each ray, then the colours of the samples that have
one (gpu_rays). Backward: see gpu_grid_gradient. No sum is made by atomics, so every run gives the same bits.
"""

from __future__ import annotations

import torch

from dofbench.runtime.backend import Backend
from dofbench.runtime.factored_grid import FieldRender, RaySamples
from dofbench.runtime.gpu_launch import kernels, launch

from .gpu_grid_gradient import SAMPLES, Kept, channels_of, gradients, group, sorted_by_cell, summed_at_nodes

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_ELEMENTS = 256  # samples times channels that a program reads together
_OF_RAY = 32  # samples of a ray that a program reads together
_TOO_MANY = 2**31  # samples


def field(density, colour, basis, origins, directions, views, places, lengths, starts, shape, shift, least_weight):
    # A ray's direction of view is the same for all its samples, so harmonics and matrix are multiplied once a ray.
    terms = shape.harmonics
    matrix = basis.reshape(-1, 3, terms).permute(2, 1, 0).reshape(terms, -1)
    lights = _Harmonics.apply(views.contiguous(), terms) @ matrix
    inputs = (each.contiguous() for each in (density, colour, lights, origins, directions, starts, places, lengths))
    results = _Field.apply(*inputs, shape, shift, least_weight)
    return FieldRender(color=results[:, :3], opacity=results[:, 3], distance=results[:, 4])


def field_density(density, points, shape, shift):
    found, constants = density.new_empty(len(points)), group(shape.density_rank, _ELEMENTS)
    launch(
        kernels("field.gpu_points").densities, (-(-len(points) // constants["BLOCK"]),),
        density.detach().contiguous(), points.detach().contiguous(), found, len(points), *shape.nodes, shift,
        **constants,
    )  # fmt: skip
    return found


def field_features(density, colour, points, shape):
    return _Features.apply(density.contiguous(), colour.contiguous(), points.contiguous(), shape)


def field_samples(origins, directions, spans, offsets, occupied, count):
    depth, height, width = occupied.shape
    number = len(origins)
    marks = torch.empty((number, count), dtype=torch.uint8, device=origins.device)
    counts = torch.empty(number, dtype=torch.int64, device=origins.device)
    march = kernels("field.gpu_samples")
    along, sizes = (origins, directions, spans, offsets), (count, width, height, depth)
    launch(march.mark, (number,), *along, occupied, marks, counts, *sizes, warps=1, BLOCK=128)
    starts = torch.nn.functional.pad(counts.cumsum(0), (1, 0))
    total = int(starts[-1])
    if total >= _TOO_MANY:
        for name, tensor in (("origins", origins), ("directions", directions), ("spans", spans), ("offsets", offsets)):
            if not bool(torch.isfinite(tensor).all()):
                raise FloatingPointError(f"{name}: expected finite numbers")
        raise ValueError(f"field_samples: expected fewer than {_TOO_MANY} samples")
    places, steps = origins.new_empty(total), origins.new_empty(total)
    launch(march.fill, (number,), spans, offsets, marks, starts, places, steps, count, warps=1, BLOCK=128)
    return RaySamples(starts, places, steps)


class _Harmonics(torch.autograd.Function):
    """(R, count): the spherical harmonics in directions of view (R, 3)."""

    @staticmethod
    def forward(context, views, count):
        terms = views.new_empty(len(views), count)
        blocks = (-(-len(views) // SAMPLES),)
        launch(kernels("field.gpu_points").harmonics, blocks, views, terms, len(views), COUNT=count, BLOCK=SAMPLES)
        context.save_for_backward(views)
        return terms

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        (views,) = context.saved_tensors
        by_views, count = torch.empty_like(views), gradient.shape[1]
        launch(
            kernels("field.gpu_points").harmonics_backward, (-(-len(views) // SAMPLES),), views,
            gradient.contiguous(), by_views, len(views),
            COUNT=count, BLOCK=SAMPLES,
        )  # fmt: skip
        return by_views, None


class _Field(torch.autograd.Function):
    """(R, 5): colour, opacity and distance. lights: (R, 9 colour_rank), see `gpu_rays.shade`."""

    @staticmethod
    def forward(
        context, density, colour, lights, origins, directions, starts, places, lengths, shape, shift, least_weight
    ):
        count, size = len(origins), len(places)
        device = origins.device
        every = torch.arange(size, dtype=torch.int64, device=device)
        # Of rays that begin with the same sample all but the last are empty.
        ray_of = torch.searchsorted(starts, every, right=True, out_int32=True) - 1
        ray_of = ray_of.clamp_(0, max(count - 1, 0))
        optical, slopes, weights, behind = (places.new_empty(size) for _ in range(4))
        colours, results, lost = places.new_empty(size, 3), places.new_empty(count, 5), places.new_empty(count)
        lit = torch.empty(size, dtype=torch.int32, device=device)
        counts = torch.empty((count, 2), dtype=torch.int32, device=device)
        constants = group(shape.density_rank, _ELEMENTS)
        launch(
            kernels("field.gpu_points").optical_depths, (-(-size // constants["BLOCK"]),), density, origins,
            directions, ray_of, places, lengths, optical, slopes, size, *shape.nodes, shift, **constants,
        )  # fmt: skip
        along = kernels("field.gpu_rays")
        launch(
            along.weigh, (count,), optical, places, starts, origins, directions, weights, behind, lit, counts, lost,
            results, size, least_weight, warps=1,
            BLOCK=_OF_RAY,
        )  # fmt: skip
        launch(
            along.shade, (count,), colour, lights, origins, directions, places, starts, counts, lit, weights, lost,
            colours, results, size, *shape.nodes, **group(shape.colour_rank, _ELEMENTS),
        )  # fmt: skip
        context.save_for_backward(density, colour, lights, origins, directions, starts, places)
        context.kept = Kept(ray_of, weights, behind, slopes, lit, counts, colours)
        context.options = shape, least_weight
        return results

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        shape, least_weight = context.options
        wanted = any(context.needs_input_grad[3:5])
        found = gradients(gradient.contiguous(), context.saved_tensors, context.kept, shape, least_weight, wanted)
        return *found, *[None] * 6


class _Features(torch.autograd.Function):
    """(P, C)."""

    @staticmethod
    def forward(context, density, colour, points, shape):
        size, total = len(points), shape.feature_count
        found = points.new_empty(size, total)
        for flat, (rank, first) in zip((density, colour), shape.feature_columns, strict=True):
            launch(
                kernels("field.gpu_points").products, _programs(size, rank), flat, points, found, size, *shape.nodes,
                first, total, **group(rank, _ELEMENTS),
            )  # fmt: skip
        context.save_for_backward(density, colour, points)
        context.shape = shape
        return found

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        density, colour, points = context.saved_tensors
        shape, size, gradient = context.shape, len(points), gradient.contiguous()
        # Each point counts as the only sample of a ray that begins there.
        every = torch.arange(size, dtype=torch.int32, device=points.device)
        none, one = points.new_zeros(size), points.new_ones(size)
        by_cell = sorted_by_cell(points, points, none, every, one, shape, 0.0)
        by_grids = []
        for flat, (rank, first) in zip((density, colour), shape.feature_columns, strict=True):
            by_planes, by_lines = (points.new_empty(size, 3, rank) for _ in range(2))
            launch(
                kernels("field.gpu_points").spread_products, _programs(size, rank), flat, points, gradient, by_planes,
                by_lines, size, *shape.nodes, first, gradient.shape[1], **group(rank, _ELEMENTS),
            )  # fmt: skip
            by_grids.append(summed_at_nodes(by_planes, by_lines, by_cell, torch.empty_like(flat), shape, rank, 2))
        return *by_grids, None, None


def _programs(size: int, rank: int) -> tuple[int, int]:
    """For blocks of points, and for the modes' groups of channels."""
    channels = channels_of(rank)
    return -(-size // (_ELEMENTS // channels)), 3 * rank // channels
