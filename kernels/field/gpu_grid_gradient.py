"""The gradient of `field` on a GPU.

Along each ray (gpu_rays) to the sum of a sample's density channels; then, for the density and for the colour, to its
planes and lines (gpu_spread), which are written down sample by sample; then, with the samples sorted by the cells that
they lie in, summed at the nodes (gpu_nodes).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.gpu_launch import kernels, launch

SAMPLES = 256  # of a program that has no channels in it
_OF_RAY = 32  # samples of a ray that a program reads together
# Samples times channels that a program reads together, of the density and of the colour, whose samples are fewer and
# take more registers.
_SPREAD = (256, 128)
# Nodes of a plane in a program, and samples of each cell around them that are read together, where cells have few
# samples, and where they have more than `_CROWDED` on average.
_FEW, _MANY, _CROWDED = {"NODES": 4, "EACH": 2}, {"NODES": 1, "EACH": 8}, 8
_PARTS = 4  # programs that share a cell of a line
_LISTED = 1024  # samples of a cell of a line times channels that a program reads together
_LINE_NODES = 4  # nodes of a line in a program


def channels_of(rank: int) -> int:
    """How many channels a program reads together; they divide the rank, a multiple of eight."""
    return 16 if rank % 16 == 0 else 8


def group(rank: int, elements: int, block: str = "BLOCK") -> dict[str, int]:
    """The constants of a program that has `elements` numbers in a block of samples and channels."""
    return {"RANK": rank, "CHANNELS": channels_of(rank), block: elements // channels_of(rank)}


class Kept(NamedTuple):
    """Values of S samples of R rays that the forward pass keeps.

    ray_of: (S,) int32. weights: (S,), 0 for hidden samples. behind: (S,), the transmittance behind each. slopes: (S,),
    of the optical depth by the sum of the density's channels. lit, counts: see gpu_rays. colours: (S, 3), of samples
    that have one.
    """

    ray_of: Tensor
    weights: Tensor
    behind: Tensor
    slopes: Tensor
    lit: Tensor
    counts: Tensor
    colours: Tensor


class Sorted(NamedTuple):
    """Samples by cell, see gpu_nodes: order, (6 S,); first_in, where each number of a cell begins in it; shares, (S,
    3)."""

    order: Tensor
    first_in: Tensor
    shares: Tensor


def gradients(
    gradient: Tensor, saved: tuple[Tensor, ...], kept: Kept, shape: GridShape, least_weight: float, wanted: bool
) -> tuple[Tensor | None, ...]:
    """The gradients with respect to density, colour, lights, origins and directions, the last two None if not wanted.

    gradient: (R, 5), by what the rays see. saved: density, colour, lights, origins, directions, starts, places.
    """
    density, colour, lights, origins, directions, starts, places = saved
    count, size = len(origins), len(places)
    by_feature = places.new_empty(size)
    launch(
        kernels("field.gpu_rays").weigh_backward, (count,), gradient, starts, kept.counts, kept.weights, kept.behind,
        kept.slopes, places, kept.colours, by_feature, size, least_weight, warps=1,
        BLOCK=_OF_RAY,
    )  # fmt: skip
    by_cell = sorted_by_cell(origins, directions, places, kept.ray_of, kept.weights, shape, least_weight)
    parts = [3 * rank // channels_of(rank) for rank in (shape.density_rank, shape.colour_rank)]
    by_lights = torch.empty_like(lights)
    by_rays = places.new_empty((sum(parts), count, 6)) if wanted else places
    found = []
    for is_colour, (flat, rank) in enumerate(((density, shape.density_rank), (colour, shape.colour_rank))):
        by_planes, by_lines = (places.new_empty(size, 3, rank) for _ in range(2))
        launch(
            kernels("field.gpu_spread").spread, (count, parts[is_colour]), flat, lights, gradient, origins, directions,
            places, starts, kept.counts, kept.lit, kept.weights, kept.colours, by_feature, by_planes, by_lines,
            by_lights, by_rays, size, *shape.nodes, parts[0] if is_colour else 0,
            COLOUR=is_colour, WANTED=wanted, **group(rank, _SPREAD[is_colour]),
        )  # fmt: skip
        found.append(
            summed_at_nodes(by_planes, by_lines, by_cell, torch.empty_like(flat), shape, rank, 1 if is_colour else 2)
        )
    along = by_rays.sum(0) if wanted else None
    of_rays = (None, None) if along is None else (along[:, :3], along[:, 3:])
    return *found, by_lights, *of_rays


def sorted_by_cell(
    origins: Tensor, directions: Tensor, places: Tensor, ray_of: Tensor, weights: Tensor, shape: GridShape,
    least_weight: float,
) -> Sorted:  # fmt: skip
    """The samples by the cells that they lie in; those of less than the least weight come last in theirs."""
    size, (nx, ny, nz) = len(places), shape.nodes
    of_planes = (nx - 1) * (ny - 1) + (nx - 1) * (nz - 1) + (ny - 1) * (nz - 1)
    numbers = 2 * (of_planes + nx + ny + nz - 3)
    cells = torch.empty(6 * size, dtype=torch.int32, device=places.device)
    shares = places.new_empty(size, 3)
    launch(
        kernels("field.gpu_nodes").find_cells, (-(-size // SAMPLES),), origins, directions, ray_of, places, weights,
        cells, shares, size, nx, ny, nz, least_weight, numbers,
        BLOCK=SAMPLES,
    )  # fmt: skip
    # A stable sort has one result, so sums over a cell have one order.
    cells, order = torch.sort(cells, stable=True)
    every = torch.arange(numbers + 1, dtype=torch.int32, device=places.device)
    return Sorted(order, torch.searchsorted(cells, every, out_int32=True), shares)


def summed_at_nodes(
    by_planes: Tensor, by_lines: Tensor, by_cell: Sorted, result: Tensor, shape: GridShape, rank: int, numbers: int
) -> Tensor:
    """Fill result, like the flat tensor, with its gradient. numbers: how many of a cell's two numbers count."""
    nodes = kernels("field.gpu_nodes")
    size, (nx, ny, nz) = len(by_planes), shape.nodes
    groups = rank // channels_of(rank)
    of_planes = nx * ny + nx * nz + ny * nz
    constants = {"RANK": rank, "CHANNELS": channels_of(rank)}
    tile = _MANY if 3 * size > _CROWDED * of_planes else _FEW
    launch(
        nodes.add_to_planes, (-(-of_planes // tile["NODES"]), groups), by_planes, *by_cell, result, size, nx, ny, nz,
        NUMBERS=numbers, **tile, **constants,
    )  # fmt: skip
    line_cells = nx + ny + nz - 3
    sums = result.new_empty(line_cells, _PARTS, 2, rank)
    launch(
        nodes.add_in_line_cells, (line_cells, _PARTS, groups), by_lines, *by_cell, sums, size, nx, ny, nz,
        NUMBERS=numbers, **group(rank, _LISTED, "EACH"),
    )  # fmt: skip
    launch(
        nodes.add_to_lines, (-(-(nx + ny + nz) // _LINE_NODES), groups), sums, result, nx, ny, nz,
        PARTS=_PARTS, NODES=_LINE_NODES, **constants,
    )  # fmt: skip
    return result
