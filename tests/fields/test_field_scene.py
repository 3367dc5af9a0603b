"""Where along a ray the field is looked at, beside what it renders."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch
from tolerances import AS_IF_INFINITELY_FAR, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.runtime.factored_grid import FieldRender
from dofbench.runtime.ops import load
from dofbench.training.fields.cube_rays import CubeRays, RaysSeen, Space, points_along
from dofbench.training.fields.field_options import FieldOptions, RayOptions
from dofbench.training.fields.field_scene import FieldScene, Occupancy
from dofbench.training.fields.grid_field import GridField, GridOptions
from dofbench.training.fields.space import Frustum
from dofbench.training.fields.unbounded import Unbounded

# Disparities from 1 to 0.2 before a camera that sees as far to each side as ahead.
FRUSTUM = Frustum(np.eye(4), np.array([-1.0, -1.0]), np.array([1.0, 1.0]), 1.0, 0.2)
UNBOUNDED = Unbounded(np.array([-1.0, 2.0, 1.0]), np.array([1.0, 6.0, 5.0]), 0.0)


def scene(space: Space = FRUSTUM, **rays: float) -> FieldScene:
    options = FieldOptions(
        rays=RayOptions(cells=4, ray_samples=20, **rays), grid=GridOptions(grid_nodes=12, grid_nodes_first=6)
    )
    field = GridField.at_random(options.grid.shape((6, 5, 4)), -4.0, torch.Generator().manual_seed(0))
    return FieldScene(field, space, options)


def rays(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Beside the camera, straight ahead."""
    origins = torch.tensor([[0.5, -0.4, 0.0]]).repeat(count, 1).requires_grad_()
    return origins, torch.tensor([[0.0, 0.0, 1.0]]).repeat(count, 1)


def in_frustum(shares: Sequence[float]) -> torch.Tensor:
    """(N, 3) where these rays are in the cube at shares of the way from the near to the far disparity."""
    disparities = [1 - 0.8 * share for share in shares]
    return torch.tensor(
        [[(1 + 0.5 * q) / 2, (1 - 0.4 * q) / 2, share] for q, share in zip(disparities, shares, strict=True)]
    )


def seen_in_frustum(opacity: Sequence[float], distance: Sequence[float]) -> RaysSeen:
    found = FieldRender(torch.zeros(len(opacity), 3), torch.tensor(opacity), torch.tensor(distance))
    return RaysSeen.of(found, FRUSTUM.pieces(*rays(len(opacity))))


def test_features_along_a_ray_are_those_in_the_middle_of_its_parts() -> None:
    made = scene()
    origins, directions = rays(3)
    found = made.features_along(origins, directions, 4)
    expected = made.field.features(in_frustum([0.125, 0.375, 0.625, 0.875]))
    assert found.shape == (3, 4, GridOptions().feature_count)
    for one in found:
        torch.testing.assert_close(one, expected, rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)
    found.sum().backward()
    assert origins.grad is None and float(made.field.parameters["colour"].grad.abs().sum()) > 0


def test_the_mean_place_counts_what_nothing_met_as_the_end() -> None:
    """All light from 0.25 of the way; half of it, the other half from nowhere; all from nowhere."""
    made, seen, shares = scene(), seen_in_frustum([1.0, 0.5, 0.0], [0.25, 0.125, 0.0]), [0.25, 0.625, 1.0]
    found = made.features_met(*rays(3), seen)
    torch.testing.assert_close(
        found, made.field.features(in_frustum(shares)), rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE
    )
    expected = torch.tensor([1 - 0.8 * share for share in shares])
    torch.testing.assert_close(made.disparity(*rays(3), seen), expected, rtol=FLOAT32_VALUE, atol=0)


def test_pieces_of_a_ray_are_seen_one_behind_the_other() -> None:
    """As if all samples of a ray were composited one by one, where none is so faint that its colour is left out."""
    made = scene(UNBOUNDED, least_weight=0.0)
    # So dense that a piece hides part of the next, and so uneven that it matters where a sample lies.
    parameters = {name: 8 * tensor for name, tensor in made.field.parameters.items()}
    made.field = GridField(made.field.shape, parameters, 0.0)
    generator = torch.Generator().manual_seed(2)
    origins = torch.tensor([0.0, 4.0, 3.0]) + 3 * torch.randn(40, 3, generator=generator)
    directions = torch.randn(40, 3, generator=generator)
    offsets = torch.rand(40, generator=generator)
    seen = made.see(origins, directions, offsets)
    colours, opacities = composited(made, origins, directions, offsets)
    torch.testing.assert_close(seen.opacity.double(), opacities, rtol=FLOAT32_GRADIENT, atol=0)
    torch.testing.assert_close(seen.color.double(), colours, rtol=0, atol=FLOAT32_GRADIENT)
    torch.testing.assert_close(seen.weights.sum(0), torch.ones(40), rtol=FLOAT32_GRADIENT, atol=0)
    assert bool((seen.met.amax(1) > 0.1).all())  # every piece is seen by some ray


def composited(
    made: FieldScene, origins: torch.Tensor, directions: torch.Tensor, offsets: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(R, 3) colours and (R,) opacities, float64, by the definition of the kernel for one sample after the other."""
    own = {name: tensor.detach().double() for name, tensor in made.field.parameters.items()}
    views = torch.nn.functional.normalize(directions, dim=1).double()
    colours, left = torch.zeros(len(origins), 3).double(), torch.ones(len(origins)).double()
    counts = (10, 2, 2, 2)  # a quarter of the ten steps beyond the box
    for count, piece in zip(counts, UNBOUNDED.pieces(origins.double(), directions.double()), strict=True):
        step = (piece.spans[:, 1] - piece.spans[:, 0]).clamp_min(0) / count
        for number in range(count):
            one = load("field", "reference")(
                **own,
                origins=piece.origins,
                directions=piece.directions,
                views=views,
                starts=torch.arange(len(origins) + 1),
                places=piece.spans[:, 0] + (number + offsets) * step,
                lengths=step * piece.gain,
                shape=made.field.shape,
                shift=made.field.shift,
            )
            colours += left[:, None] * one.color
            left = left * (1 - one.opacity)
    return colours, 1 - left


def test_what_was_met_in_several_pieces_has_the_mean_disparity_and_the_features_of_the_most() -> None:
    """A quarter of the light in the box at depth 3, the rest beyond it at depth 7.5; and a ray that met nothing at all,
    which counts as infinitely far away."""
    made = scene(UNBOUNDED)
    origins, directions = torch.tensor([[0.3, 4.0, 0.0]]).repeat(2, 1), torch.tensor([[0.0, 0.0, 1.0]]).repeat(2, 1)
    pieces = UNBOUNDED.pieces(origins, directions)
    far = bisected(lambda place: float(UNBOUNDED.depths(origins, directions, torch.full((4, 2), place))[3, 0]) - 7.5)
    opacity = torch.tensor([[0.25, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    distance = opacity * torch.tensor([[3.0], [0.0], [0.0], [far]])
    seen = RaysSeen.of(FieldRender(torch.zeros(8, 3), opacity.flatten(), distance.flatten()), pieces)
    found = made.disparity(origins, directions, seen)
    assert float(found[0]) == pytest.approx(0.25 / 3 + 0.75 / 7.5, rel=FLOAT32_GRADIENT)
    assert 0 <= float(found[1]) <= AS_IF_INFINITELY_FAR
    met = made.field.features(pieces[3].points(torch.full((2,), far))[:1])
    torch.testing.assert_close(made.features_met(origins, directions, seen)[:1], met, rtol=0, atol=FLOAT32_VALUE)


def bisected(rises: Callable[[float], float]) -> float:
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rises(middle) < 0 else (low, middle)
    return low


def test_features_along_pieces_are_equally_far_apart() -> None:
    """By the length in the cube, in which the box is as wide as the sides of the space say."""
    made = scene(UNBOUNDED)
    generator = torch.Generator().manual_seed(4)
    origins, directions = torch.randn(2, 30, 3, generator=generator, dtype=torch.float64)
    origins = origins + torch.tensor([0.0, 4.0, 3.0])
    points = points_along(UNBOUNDED.pieces(origins, directions), (torch.arange(400).double() + 0.5) / 400)
    apart = (points.diff(dim=1) * torch.tensor([1.0, 2.0, 2.0])).norm(dim=2)
    # Where a ray bends, the straight way is shorter; a ray bends three times at most.
    equal = (apart - apart.median(1, keepdim=True).values).abs() <= FLOAT32_GRADIENT
    assert int((~equal).sum(1).max()) <= 3
    found = made.features_along(origins.float(), directions.float(), 5)
    assert found.shape == (30, 5, GridOptions().feature_count) and bool(torch.isfinite(found).all())


def test_a_coarse_grid_has_longer_steps() -> None:
    """Half the nodes of the last size, half of 20 steps of twice the length: in a field that is opaque everywhere, what
    a ray meets is its first sample, in the middle of its first step."""
    made = scene()
    made.field = GridField(made.field.shape, made.field.parameters, 40.0)  # opaque
    half = torch.full((1,), 0.5)
    coarse = made.see(*rays(1), half).places[0]
    made.field = made.field.resized(GridOptions().shape((12, 10, 8)))
    fine = made.see(*rays(1), half).places[0]
    expected = torch.tensor([1 / 10 / 2, 1 / 20 / 2])
    torch.testing.assert_close(torch.cat([coarse, fine]), expected, rtol=FLOAT32_GRADIENT, atol=0)


def test_a_cell_is_empty_by_what_a_step_of_that_length_absorbs() -> None:
    """Density 0.00134 everywhere, in units of a hundredth of a ray: one of 10 steps absorbs 1.33 %, one of 20 steps
    0.67 %, and a cell is empty below 1 %."""
    made = scene()
    for fine, occupied in ((False, True), (True, False)):
        shape = GridOptions().shape((12, 10, 8) if fine else (6, 5, 4))
        sizes = {"density": shape.density_size, "colour": shape.colour_size, "basis": shape.basis_shape}
        made.field = GridField(shape, {name: torch.zeros(size) for name, size in sizes.items()}, math.log(0.00134))
        made.look_for_empty_cells(torch.Generator().manual_seed(0))
        assert bool(made.occupancy.occupied.all()) == occupied == bool(made.occupancy.occupied.any())


CELLS = 8


def wall(thick: float = 0.15) -> GridField:
    """Dense from z = 0.55 to 0.55 + thick, nearly empty elsewhere."""
    shape = GridOptions(sh_degree=0).shape((3, 3, 65))
    made = GridField.at_random(shape, -12.0, torch.Generator().manual_seed(0))
    z = torch.linspace(0, 1, 65)
    with torch.no_grad():
        made.parameters["density"].zero_()
        shape.planes(made.parameters["density"], 8)[0][..., 0] = 1.0
        shape.lines(made.parameters["density"], 8)[0][:, 0] = torch.where((z >= 0.55) & (z <= 0.55 + thick), 20.0, 0.0)
    return made


def along_z(count: int) -> CubeRays:
    origins = torch.rand(count, 3, generator=torch.Generator().manual_seed(2))
    origins[:, 2] = 0
    directions = torch.tensor([[0.0, 0.0, 1.0]]).expand(count, 3).contiguous()
    spans = torch.tensor([[0.0, 1.0]]).expand(count, 2).contiguous()
    return CubeRays(origins, directions, spans, torch.ones(count))


def test_everything_is_occupied_at_first() -> None:
    samples = Occupancy(CELLS, 0.01).samples(along_z(5), 16, torch.full((5,), 0.5))
    assert samples.starts.tolist() == [0, 16, 32, 48, 64, 80]


def test_samples_lie_at_the_wall_and_a_cell_beside_it() -> None:
    occupancy = Occupancy(CELLS, 0.01)
    occupancy.update(wall(), 1.0, torch.Generator().manual_seed(0))
    found = occupancy.occupied.any(dim=2).any(dim=1)
    assert found.tolist() == [False, False, False, True, True, True, True, False]
    samples = occupancy.samples(along_z(5), 32, torch.full((5,), 0.5))
    assert len(samples.places) == 5 * 16 and 0.375 < float(samples.places.min()) < float(samples.places.max()) < 0.875


def test_a_wall_that_vanished_is_forgotten() -> None:
    occupancy, generator = Occupancy(CELLS, 0.01), torch.Generator().manual_seed(0)
    occupancy.update(wall(), 1.0, generator)
    empty = wall(-1.0)
    updates = 0
    while occupancy.occupied.any() and updates < 200:
        occupancy.update(empty, 1.0, generator)
        updates += 1
    # A density of 8 is forgotten by a tenth each time, down to the 0.01 that a cell must absorb.
    assert 60 < updates < 75
