"""Where along a ray the field is looked at, beside what it renders."""

from __future__ import annotations

import math

import numpy as np
import torch
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.compute.factored_grid import FieldRender
from dofbench.fields.field_options import FieldOptions, RayOptions
from dofbench.fields.field_scene import FieldScene
from dofbench.fields.grid_field import GridField, GridOptions
from dofbench.fields.space import Box

# A box from -1 to 1, 2 to 6 and 1 to 5: rays along z from the origin of the first two axes begin at 1 and end at 5.
BOX = Box(np.array([-1.0, 2.0, 1.0]), np.array([1.0, 6.0, 5.0]))


def scene() -> FieldScene:
    options = FieldOptions(
        rays=RayOptions(cells=4, ray_samples=20), grid=GridOptions(grid_nodes=12, grid_nodes_first=6)
    )
    field = GridField.at_random(options.grid.shape((6, 5, 4)), -4.0, torch.Generator().manual_seed(0))
    return FieldScene(field, BOX, options)


def rays(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    origins = torch.tensor([[0.5, 3.0, 0.0]]).repeat(count, 1).requires_grad_()
    return origins, torch.tensor([[0.0, 0.0, 1.0]]).repeat(count, 1)


def test_features_along_a_ray_are_those_in_the_middle_of_its_parts() -> None:
    made = scene()
    origins, directions = rays(3)
    found = made.features_along(origins, directions, 4)
    places = torch.tensor([[0.75, 0.25, share] for share in (0.125, 0.375, 0.625, 0.875)])
    expected = made.field.features(places)
    assert found.shape == (3, 4, GridOptions().feature_count)
    for one in found:
        torch.testing.assert_close(one, expected, rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)
    found.sum().backward()
    assert origins.grad is None and float(made.field.parameters["colour"].grad.abs().sum()) > 0


def test_features_met_are_those_at_the_mean_place() -> None:
    """All light from 2; half of it, the other half from nowhere, which counts as the end; all from nowhere."""
    made = scene()
    opacity, distance = torch.tensor([1.0, 0.5, 0.0]), torch.tensor([2.0, 1.0, 0.0])
    found = made.features_met(*rays(3), FieldRender(torch.zeros(3, 3), opacity, distance))
    places = torch.tensor([[0.75, 0.25, (z - 1) / 4] for z in (2.0, 3.5, 5.0)])
    torch.testing.assert_close(found, made.field.features(places), rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)


def test_a_ray_that_misses_the_box_has_features_of_its_border() -> None:
    made = scene()
    found = made.features_along(torch.tensor([[9.0, 9.0, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]]), 2)
    assert bool(torch.isfinite(found).all()) and torch.equal(found[0, 0], found[0, 1])


def test_a_coarse_grid_has_longer_steps() -> None:
    """Half the nodes of the last size, half of 20 steps of twice the length: in a field that is opaque everywhere, what
    a ray meets is its first sample, in the middle of its first step."""
    made = scene()
    made.field = GridField(made.field.shape, made.field.parameters, 40.0)  # opaque
    half = torch.full((1,), 0.5)
    coarse = made.see(*rays(1), half).distance
    made.field = made.field.resized(GridOptions().shape((12, 10, 8)))
    fine = made.see(*rays(1), half).distance
    expected = torch.tensor([1 + 4 / 10 / 2, 1 + 4 / 20 / 2])
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
