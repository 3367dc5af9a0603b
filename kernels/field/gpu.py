"""The radiance field on a GPU: Triton kernels behind one autograd function; float32. See reference.py for the
definition.

Forward: every sample's optical depth (gpu_density), weights along each ray, then the colours of the samples that have
one (gpu_rays). Backward: see gpu_grid_gradient. No sum is made by atomics, so every run gives the same bits.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.factored_grid import FieldRender, GridShape, RaySamples
from dofbench.runtime.gpu_launch import check_tensors, kernels, launch

from .gpu_grid_gradient import Kept, gradients, sorted_by_cell, summed_at_nodes
from .gpu_ray_inputs import SAMPLES, channels_of, check, group

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_ELEMENTS = 256  # samples times channels that a program reads together
_OF_RAY = 32  # samples of a ray that a program reads together
_TOO_MANY = 2**31  # samples


def field(
    density: Tensor,
    colour: Tensor,
    basis: Tensor,
    origins: Tensor,
    directions: Tensor,
    views: Tensor,
    starts: Tensor,
    places: Tensor,
    lengths: Tensor,
    *,
    shape: GridShape,
    shift: float,
    least_weight: float = 0.0,
) -> FieldRender:
    """Render R rays, each through samples of its own; see `reference.field`. float32 on a GPU.

    The same input gives the same bits. The host doesn't wait for the device, so rays and places that aren't finite make
    NaN of what the ray sees instead of raising, and `starts` that don't rise from 0 to the number of samples aren't
    told. Raises ValueError for tensors of another type, device or shape.
    """
    rays = {"origins": origins, "directions": directions, "views": views}
    samples = {"places": places, "lengths": lengths}
    check({"density": density, "colour": colour, "basis": basis}, rays, starts, samples, shape)
    # A ray's direction of view is the same for all its samples, so harmonics and matrix are multiplied once a ray.
    terms = shape.harmonics
    matrix = basis.reshape(-1, 3, terms).permute(2, 1, 0).reshape(terms, -1)
    lights = _Harmonics.apply(views.contiguous(), terms) @ matrix
    results = _Field.apply(
        *(each.contiguous() for each in (density, colour, lights, origins, directions, starts, places, lengths)),
        shape,
        float(shift),
        float(least_weight),
    )
    return FieldRender(color=results[:, :3], opacity=results[:, 3], distance=results[:, 4])


def field_density(density: Tensor, points: Tensor, *, shape: GridShape, shift: float) -> Tensor:
    """(P,) density at points (P, 3); see `reference.field_density`. float32 on a GPU, without gradient.

    NaN at points that aren't finite. Raises ValueError for tensors of another type, device or shape.
    """
    check_tensors("field_density", density=density, points=points)
    for name, tensor, wanted in (("density", density, (shape.density_size,)), ("points", points, (len(points), 3))):
        if tuple(tensor.shape) != wanted:
            raise ValueError(f"field_density {name}: expected {wanted}, found {tuple(tensor.shape)}")
    found = density.new_empty(len(points))
    constants = group(shape.density_rank, _ELEMENTS)
    launch(
        kernels("field.gpu_density").densities,
        (-(-len(points) // constants["BLOCK"]),),
        density.detach().contiguous(),
        points.detach().contiguous(),
        found,
        len(points),
        *shape.nodes,
        float(shift),
        **constants,
    )
    return found


def field_features(density: Tensor, colour: Tensor, points: Tensor, *, shape: GridShape) -> Tensor:
    """(P, C) planes times lines at points (P, 3); see `reference.field_features`. float32 on a GPU.

    The same input gives the same bits. NaN at points that aren't finite. Raises ValueError for tensors of another type,
    device or shape.
    """
    grids = {"density": density, "colour": colour}
    check_tensors("field_features", **grids, points=points)
    wanted = (shape.density_size,), (shape.colour_size,), (len(points), 3)
    for (name, tensor), size in zip({**grids, "points": points}.items(), wanted, strict=True):
        if tuple(tensor.shape) != size:
            raise ValueError(f"field_features {name}: expected {size}, found {tuple(tensor.shape)}")
    return _Features.apply(density.contiguous(), colour.contiguous(), points.detach().contiguous(), shape)


def field_samples(
    origins: Tensor, directions: Tensor, spans: Tensor, offsets: Tensor, occupied: Tensor, *, count: int
) -> RaySamples:
    """The samples of R rays in occupied cells; see `reference.field_samples`. float32 on a GPU.

    Waits for the GPU once, for the number of samples. As one number is read anyway, rays that aren't finite are told by
    it too: raises FloatingPointError for them as `cpu.field_samples` does. Raises ValueError for tensors of another
    type, device or shape.
    """
    rays = {"origins": origins, "directions": directions, "spans": spans, "offsets": offsets}
    check_tensors("field_samples", **rays)
    number = len(origins)
    wanted = {"origins": (number, 3), "directions": (number, 3), "spans": (number, 2), "offsets": (number,)}
    for name, tensor in rays.items():
        if tuple(tensor.shape) != wanted[name]:
            raise ValueError(f"field_samples {name}: expected {wanted[name]}, found {tuple(tensor.shape)}")
    if occupied.dtype != torch.bool or occupied.ndim != 3 or occupied.device != origins.device:
        found = f"{occupied.dtype} {tuple(occupied.shape)} on {occupied.device}"
        raise ValueError(f"field_samples occupied: expected bool (Z, Y, X) beside the rays, found {found}")
    along = tuple(tensor.detach().contiguous() for tensor in rays.values())
    depth, height, width = occupied.shape
    marks = torch.empty((number, count), dtype=torch.uint8, device=origins.device)
    counts = torch.empty(number, dtype=torch.int64, device=origins.device)
    march = kernels("field.gpu_samples")
    sizes = count, width, height, depth
    launch(march.mark, (number,), *along, occupied.contiguous(), marks, counts, *sizes, warps=1, BLOCK=128)
    starts = torch.nn.functional.pad(counts.cumsum(0), (1, 0))
    total = int(starts[-1])
    if total >= _TOO_MANY:
        _explain(rays)
    places, steps = origins.new_empty(total), origins.new_empty(total)
    launch(march.fill, (number,), along[2], along[3], marks, starts, places, steps, count, warps=1, BLOCK=128)
    return RaySamples(starts, places, steps)


def _explain(rays: dict[str, Tensor]) -> None:
    for name, tensor in rays.items():
        if not bool(torch.isfinite(tensor).all()):
            raise FloatingPointError(f"{name}: expected finite numbers")
    raise ValueError(f"field_samples: expected fewer than {_TOO_MANY} samples")


class _Harmonics(torch.autograd.Function):
    """(R, count): the spherical harmonics in directions of view (R, 3)."""

    @staticmethod
    def forward(context, views, count):
        terms = views.new_empty(len(views), count)
        blocks = (-(-len(views) // SAMPLES),)
        launch(kernels("field.gpu_harmonics").harmonics, blocks, views, terms, len(views), COUNT=count, BLOCK=SAMPLES)
        context.save_for_backward(views)
        return terms

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        (views,) = context.saved_tensors
        by_views, count = torch.empty_like(views), gradient.shape[1]
        launch(
            kernels("field.gpu_harmonics").harmonics_backward,
            (-(-len(views) // SAMPLES),),
            views,
            gradient.contiguous(),
            by_views,
            len(views),
            COUNT=count,
            BLOCK=SAMPLES,
        )
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
            kernels("field.gpu_density").optical_depths,
            (-(-size // constants["BLOCK"]),),
            density,
            origins,
            directions,
            ray_of,
            places,
            lengths,
            optical,
            slopes,
            size,
            *shape.nodes,
            shift,
            **constants,
        )
        along = kernels("field.gpu_rays")
        launch(
            along.weigh,
            (count,),
            optical,
            places,
            starts,
            origins,
            directions,
            weights,
            behind,
            lit,
            counts,
            lost,
            results,
            size,
            least_weight,
            warps=1,
            BLOCK=_OF_RAY,
        )
        launch(
            along.shade,
            (count,),
            colour,
            lights,
            origins,
            directions,
            places,
            starts,
            counts,
            lit,
            weights,
            lost,
            colours,
            results,
            size,
            *shape.nodes,
            **group(shape.colour_rank, _ELEMENTS),
        )
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
                kernels("field.gpu_features").products,
                _programs(size, rank),
                flat,
                points,
                found,
                size,
                *shape.nodes,
                first,
                total,
                **group(rank, _ELEMENTS),
            )
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
                kernels("field.gpu_features").spread_products,
                _programs(size, rank),
                flat,
                points,
                gradient,
                by_planes,
                by_lines,
                size,
                *shape.nodes,
                first,
                gradient.shape[1],
                **group(rank, _ELEMENTS),
            )
            by_grids.append(summed_at_nodes(by_planes, by_lines, by_cell, torch.empty_like(flat), shape, rank, 2))
        return *by_grids, None, None


def _programs(size: int, rank: int) -> tuple[int, int]:
    """For blocks of points, and for the modes' groups of channels."""
    channels = channels_of(rank)
    return -(-size // (_ELEMENTS // channels)), 3 * rank // channels
