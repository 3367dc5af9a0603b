"""The definition of `field` in plain torch, for any floating type; gradients by autograd. See op.py."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import softplus

from dofbench.runtime.backend import Backend
from dofbench.runtime.factored_grid import MODES, FieldRender, GridShape, RaySamples

from .op import LEAST_TRANSMITTANCE

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def harmonics(directions: Tensor, count: int) -> Tensor:
    """(N, count): the real spherical harmonics up to degree 0, 1 or 2 in unit directions (N, 3), orthonormal on the
    sphere."""
    x, y, z = directions.unbind(1)
    terms = [torch.full_like(x, 0.28209479177387814)]
    if count > 1:
        terms += [0.4886025119029199 * y, 0.4886025119029199 * z, 0.4886025119029199 * x]
    if count > 4:
        terms += [
            1.0925484305920792 * x * y,
            1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    return torch.stack(terms, 1)


def field_density(density: Tensor, points: Tensor, shape: GridShape, shift: float) -> Tensor:
    factors = _factors(density, points, shape, shape.density_rank)
    return softplus(torch.stack([factor.sum(1) for factor in factors]).sum(0) + shift)


def field_features(density: Tensor, colour: Tensor, points: Tensor, shape: GridShape) -> Tensor:
    grids = (density, shape.density_rank), (colour, shape.colour_rank)
    return torch.cat([factor for flat, rank in grids for factor in _factors(flat, points, shape, rank)], 1)


def field(
    density: Tensor, colour: Tensor, basis: Tensor, origins: Tensor, directions: Tensor, views: Tensor, places: Tensor,
    lengths: Tensor, starts: Tensor, shape: GridShape, shift: float, least_weight: float,
) -> FieldRender:  # fmt: skip
    count = len(origins)
    ray = torch.repeat_interleave(torch.arange(count, device=starts.device), starts.diff())
    points = origins[ray] + places[:, None] * directions[ray]
    optical = field_density(density, points, shape, shift) * lengths
    transmittance = torch.exp(-_before(optical, ray, starts))
    seen = ~(transmittance.detach() < LEAST_TRANSMITTANCE)  # NaN counts, so that it comes out
    weight = torch.where(seen, -transmittance * torch.expm1(-optical), 0.0)
    factors = _factors(colour, points, shape, shape.colour_rank)
    coefficients = (torch.cat(factors, 1) @ basis).view(-1, 3, shape.harmonics)
    colours = torch.sigmoid((coefficients * harmonics(views, shape.harmonics)[ray][:, None]).sum(2))
    lit = torch.where(weight.detach() >= least_weight, weight, 0.0)
    return FieldRender(
        color=_per_ray(lit[:, None] * colours, ray, count),
        opacity=_per_ray(weight, ray, count),
        distance=_per_ray(weight * places, ray, count),
    )


def field_samples(
    origins: Tensor, directions: Tensor, spans: Tensor, offsets: Tensor, occupied: Tensor, count: int
) -> RaySamples:
    length = (spans[:, 1] - spans[:, 0]) / count
    places = spans[:, :1] + (torch.arange(count, device=spans.device) + offsets[:, None]) * length[:, None]
    points = origins[:, None] + places[..., None] * directions[:, None]
    cells = [_cell_of(points[..., axis], occupied.shape[2 - axis]) for axis in range(3)]
    taken = occupied[cells[2], cells[1], cells[0]] & (length > 0)[:, None]
    starts = torch.nn.functional.pad(taken.sum(1).cumsum(0), (1, 0))
    return RaySamples(starts, places[taken], length[:, None].expand_as(places)[taken].contiguous())


def _cell_of(coordinate: Tensor, cells: int) -> Tensor:
    return (coordinate.clamp(0, 1) * cells).floor().clamp(max=cells - 1).long()


def _before(optical: Tensor, ray: Tensor, starts: Tensor) -> Tensor:
    """(S,) the sum over the samples of the same ray that lie before each. Summed ray by ray, so that rays don't round
    each other's sums."""
    number = torch.arange(len(optical), device=optical.device) - starts[ray]
    most = int(starts.diff().max()) if len(starts) > 1 else 0
    table = optical.new_zeros((len(starts) - 1, most + 1)).index_put((ray, number + 1), optical)
    return table.cumsum(1)[ray, number]


def _per_ray(values: Tensor, ray: Tensor, count: int) -> Tensor:
    return values.new_zeros((count, *values.shape[1:])).index_add(0, ray, values)


def _factors(flat: Tensor, points: Tensor, shape: GridShape, rank: int) -> list[Tensor]:
    """For each mode (P, rank): its plane times its line at the points."""
    found = []
    for (column, row, axis), plane, line in zip(MODES, *shape.parts(flat, rank), strict=True):
        across, u = _cell(points[:, column], shape.nodes[column])
        down, v = _cell(points[:, row], shape.nodes[row])
        along, w = _cell(points[:, axis], shape.nodes[axis])
        upper = plane[down, across] * (1 - u) + plane[down, across + 1] * u
        lower = plane[down + 1, across] * (1 - u) + plane[down + 1, across + 1] * u
        found.append((upper * (1 - v) + lower * v) * (line[along] * (1 - w) + line[along + 1] * w))
    return found


def _cell(coordinate: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """The node below each coordinate (P,) in [0, 1], and (P, 1) the share of the way to the next."""
    scaled = coordinate.clamp(0, 1) * (nodes - 1)
    below = scaled.detach().floor().clamp(max=nodes - 2)
    return below.long(), (scaled - below)[:, None]
