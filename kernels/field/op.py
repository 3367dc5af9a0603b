"""A radiance field on a factorised grid.

A point of the unit cube has a density and a colour's coefficients by TensoRF's vector-matrix decomposition (Chen et
al., ECCV 2022, section 4.2): for each mode, a plane at two coordinates times a line at the third, both interpolated
linearly between nodes. Rays are rendered by the quadrature of NeRF (Mildenhall et al., ECCV 2020, Eq. 3).

`density` and `colour` are flat, `shape.density_size` and `shape.colour_size` numbers. Points outside the cube count as
on its border. Compiled backends give the same bits in every run. All functions raise ValueError for a wrong shape or
type. Rays, places and points that aren't finite raise FloatingPointError on the CPU; on a GPU they give NaN, since
raising would have the host wait for the device, except in `field_samples`, which raises there too.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.factored_grid import FieldRender, GridShape, RaySamples
from dofbench.runtime.ops import AUTO, implementation

__all__ = ["field", "field_density", "field_features", "field_samples"]

LEAST_TRANSMITTANCE = 1e-4  # samples behind so little light are skipped, as in 3DGS


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
    backend: str = AUTO,
) -> FieldRender:
    """Render R rays, each through samples of its own.

    basis: `shape.basis_shape`, from a point's colour channels to its coefficients. origins, directions: (R, 3) in the
    unit cube; a sample lies at origin + place * direction. views: (R, 3), unit directions that colours depend on.
    starts: (R + 1,) int64, rising from 0 to S; ray r has samples starts[r] to starts[r + 1], from near to far. places:
    (S,) along the rays. lengths: (S,), factor on a sample's density. shift: see `field_density`. least_weight: samples
    of less weight have no colour.

    Differentiable with respect to all but the last three tensors. Samples behind a transmittance of
    `LEAST_TRANSMITTANCE` are skipped.
    """
    count, size = len(origins), len(places)
    tensors = {
        "density": density, "colour": colour, "basis": basis, "origins": origins, "directions": directions,
        "views": views, "places": places, "lengths": lengths,
    }  # fmt: skip
    grids = (shape.density_size,), (shape.colour_size,), shape.basis_shape
    _check("field", tensors, (*grids, *3 * [(count, 3)], *2 * [(size,)]))
    if starts.dtype != torch.int64 or tuple(starts.shape) != (count + 1,) or starts.device != origins.device:
        found = f"{starts.dtype} {tuple(starts.shape)} on {starts.device}"
        raise ValueError(f"field starts: expected int64 {(count + 1,)} on {origins.device}, found {found}")
    if size and not count:
        raise ValueError(f"field starts: expected no samples without a ray, found {size}")
    found_in = implementation("field", backend, **tensors)
    result: FieldRender = found_in.field(*tensors.values(), starts, shape, float(shift), float(least_weight))
    return result


def field_density(density: Tensor, points: Tensor, *, shape: GridShape, shift: float, backend: str = AUTO) -> Tensor:
    """(P,) density per unit of length at points (P, 3) of the unit cube. The compiled backends have no gradient.

    shift: added before the softplus, so that an empty grid is nearly transparent.
    """
    tensors = {"density": density, "points": points}
    _check("field_density", tensors, ((shape.density_size,), (len(points), 3)))
    return implementation("field", backend, **tensors).field_density(density, points, shape, float(shift))


def field_features(density: Tensor, colour: Tensor, points: Tensor, *, shape: GridShape, backend: str = AUTO) -> Tensor:
    """(P, C) planes times lines at points (P, 3) of the unit cube, without the sums that make a density and colours of
    them: the density's channels, then the colour's, mode by mode; C = 3 (density_rank + colour_rank).

    Differentiable with respect to density and colour.
    """
    tensors = {"density": density, "colour": colour, "points": points}
    _check("field_features", tensors, ((shape.density_size,), (shape.colour_size,), (len(points), 3)))
    return implementation("field", backend, **tensors).field_features(density, colour, points.detach(), shape)


def field_samples(
    origins: Tensor,
    directions: Tensor,
    spans: Tensor,
    offsets: Tensor,
    occupied: Tensor,
    *,
    count: int,
    backend: str = AUTO,
) -> RaySamples:
    """The samples of R rays in occupied cells of the unit cube. Not differentiable.

    origins, directions: (R, 3) in the unit cube. spans: (R, 2), the places where each ray begins and ends; a ray that
    ends before it begins has no samples. offsets: (R,) in [0, 1): each ray is divided into `count` equal steps, and a
    sample lies so far into its step. occupied: (Z, Y, X) bool. On a GPU the host waits once, for the number of samples.
    """
    tensors = {"origins": origins, "directions": directions, "spans": spans, "offsets": offsets}
    rays = len(origins)
    _check("field_samples", tensors, ((rays, 3), (rays, 3), (rays, 2), (rays,)))
    if occupied.dtype != torch.bool or occupied.ndim != 3 or occupied.device != origins.device:
        found = f"{occupied.dtype} {tuple(occupied.shape)} on {occupied.device}"
        raise ValueError(f"field_samples occupied: expected bool (Z, Y, X) on {origins.device}, found {found}")
    found_in = implementation("field", backend, **tensors)
    along = (tensor.detach().contiguous() for tensor in tensors.values())
    result: RaySamples = found_in.field_samples(*along, occupied.contiguous(), count)
    return result


def _check(function: str, tensors: dict[str, Tensor], shapes: tuple[tuple[int, ...], ...]) -> None:
    for (name, tensor), expected in zip(tensors.items(), shapes, strict=True):
        if tensor.shape != expected:
            raise ValueError(f"{function} {name}: expected shape {expected}, found {tuple(tensor.shape)}")
