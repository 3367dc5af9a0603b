"""The grid grows without changing what it stands for, and its roughness is what it says."""

from __future__ import annotations

import pytest
import torch
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.errors import InputError
from dofbench.runtime.factored_grid import GridShape
from dofbench.training.fields.grid_field import PARAMETERS, GridField, GridOptions

OPTIONS = GridOptions(grid_nodes=32, grid_nodes_first=8, grid_grows=2, grid_grown=0.5, sh_degree=1)


def field(nodes: tuple[int, int, int] = (5, 4, 3)) -> GridField:
    return GridField.at_random(OPTIONS.shape(nodes), -1.0, torch.Generator().manual_seed(0))


def test_nodes_grow_in_equal_ratios() -> None:
    assert [OPTIONS.nodes(progress) for progress in (0, 0.24, 0.25, 0.49, 0.5, 1)] == [8, 8, 16, 16, 32, 32]


def test_a_finer_grid_whose_nodes_hold_the_old_ones_is_the_same_function() -> None:
    coarse = field()
    fine = coarse.resized(OPTIONS.shape((9, 7, 5)))
    points = torch.rand(300, 3, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(fine.density(points), coarse.density(points), rtol=FLOAT32_VALUE, atol=0)
    assert torch.equal(fine.parameters["basis"], coarse.parameters["basis"])
    ranks = {"density": 8, "colour": 16}
    for name, rank in ranks.items():
        old, new = (one.shape.planes(one.parameters[name].detach(), rank) for one in (coarse, fine))
        for a, b in zip(old, new, strict=True):
            torch.testing.assert_close(b[::2, ::2], a, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)
    assert all(fine.parameters[name].requires_grad for name in PARAMETERS)


def test_features_are_what_density_and_colours_are_made_of() -> None:
    """The density is the softplus of the sum of its channels; a plane times a line at a node is their numbers there."""
    made = field()
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(2)) * 1.4 - 0.2  # some outside
    features = made.features(points).detach()
    assert features.shape == (50, OPTIONS.feature_count) == (50, 72)
    found = torch.nn.functional.softplus(features[:, :24].sum(1) - 1.0)
    torch.testing.assert_close(found, made.density(points), rtol=FLOAT32_GRADIENT, atol=0)
    flat = made.parameters["colour"].detach()
    plane, line = made.shape.planes(flat, 16)[1], made.shape.lines(flat, 16)[1]  # x and z, along y
    node = made.features(torch.tensor([[2 / 4, 1 / 3, 2 / 2]])).detach()[0, 24 + 16 : 24 + 32]
    torch.testing.assert_close(node, plane[2, 2] * line[1], rtol=FLOAT32_GRADIENT, atol=FLOAT32_VALUE)
    made.features(points).sum().backward()
    assert all(float(made.parameters[name].grad.abs().sum()) > 0 for name in ("density", "colour"))


def test_roughness_of_a_ramp() -> None:
    """A plane that rises by 0.5 from column to column, in one channel of eight: 0.25 / 8 for each pair."""
    made = field()
    with torch.no_grad():
        for name in ("density", "colour"):
            made.parameters[name].zero_()
        made.shape.planes(made.parameters["density"], 8)[1][..., 3] = 0.5 * torch.arange(5)
    rough = {name: value.detach() for name, value in made.roughness().items()}
    assert float(rough["density"]) == pytest.approx(0.25 / 8) and float(rough["colour"]) == 0


def test_gradient_of_the_roughness() -> None:
    """Against torch's own derivative of the definition, weighted, in float64."""
    shape, random = GridShape((3, 4, 5), 8, 8, 1), torch.Generator().manual_seed(3)
    sizes = {"density": (shape.density_size,), "colour": (shape.colour_size,), "basis": shape.basis_shape}
    numbers = {name: torch.randn(size, generator=random, dtype=torch.float64) for name, size in sizes.items()}
    made = GridField(shape, numbers, -1.0)
    (-1.5 * made.roughness()["density"]).backward()
    flat = numbers["density"].requires_grad_()
    planes = shape.planes(flat, 8)
    rough = sum(((p[1:] - p[:-1]) ** 2).mean() + ((p[:, 1:] - p[:, :-1]) ** 2).mean() for p in planes)
    (-1.5 * rough).backward()
    torch.testing.assert_close(made.parameters["density"].grad, flat.grad, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)
    assert made.parameters["colour"].grad is None


def test_a_field_begins_nearly_empty() -> None:
    options = GridOptions()
    made = GridField.at_random(options.shape((12, 12, 12)), options.density_shift, torch.Generator().manual_seed(0))
    density = made.density(torch.rand(500, 3))
    assert 0.5 < float(density.mean() * 100) < 5  # of a ray through the cube, in units of its optical depth


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"density_rank": 12}, "density_rank"),
        ({"colour_rank": 0}, "colour_rank"),
        ({"sh_degree": 3}, "sh_degree"),
        ({"grid_nodes": 90}, "grid_nodes_first"),
        ({"grid_grows": 0}, "grid_grows"),
    ],
)
def test_wrong_options(changes: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        GridOptions(**changes)
