"""Cells that hold nothing are left out, and no others."""

from __future__ import annotations

import torch

from dofbench.training.fields.cube_rays import CubeRays
from dofbench.training.fields.field_scene import Occupancy
from dofbench.training.fields.grid_field import GridField, GridOptions

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
