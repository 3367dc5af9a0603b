"""The radiance field by Triton against its definition."""

from __future__ import annotations

import math
from typing import Any

import field_cases
import pytest
import torch
from field_cases import NAMES, SMALL, assert_agrees, of_type, only_ray, random_case, rendered, without_rays
from pretended_device import pretended
from torch import Tensor

from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.ops import load
from dofbench.runtime.ops.field import gpu_grid_gradient

OUTPUTS = ("color", "opacity", "distance")


def seen_by(case: dict[str, Tensor], backend: str = "gpu", **options: Any) -> dict[str, Tensor]:
    """Outputs alone, without a gradient."""
    tensors = of_type(case, field_cases.dtype_of(backend))
    seen = load("field", backend)(**tensors, **{"shape": SMALL, "shift": -0.5, **options})
    return {name: getattr(seen, name) for name in OUTPUTS}


@pytest.mark.parametrize(
    ("nodes", "sizes", "longest", "least_weight"),
    [
        ((3, 4, 5), (8, 16, 4), 0.1, 0.0),
        ((5, 2, 3), (16, 8, 1), 30.0, 1e-3),  # dense: rays end at the least transmittance
        ((2, 3, 2), (8, 24, 9), 1.0, 1e-2),  # a rank that is no power of two
    ],
)
def test_it_agrees_with_the_definition(nodes: tuple, sizes: tuple, longest: float, least_weight: float) -> None:
    shape = GridShape(nodes, *sizes)
    case = random_case(shape, 4, rays=4, longest=longest)
    assert not field_cases.near_a_threshold(case, shape, least_weight)
    assert_agrees("gpu", case, shape, least_weight=least_weight)


def test_rays_of_more_samples_than_a_program_reads_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And cells with more than are added up at once; between them a ray of one sample."""
    monkeypatch.setattr(gpu_grid_gradient, "_PARTS", 1)
    shape = GridShape((2, 2, 3), 8, 8, 4)
    case = random_case(shape, 2, rays=3, most=2, longest=0.02)
    many, generator = 70, torch.Generator().manual_seed(0)
    drawn = [torch.rand(count, generator=generator, dtype=torch.float64).sort().values for count in (many, 1, many)]
    case |= {"starts": torch.tensor([0, many, many + 1, 2 * many + 1]), "places": torch.cat(drawn)}
    case["lengths"] = 0.05 * torch.rand(2 * many + 1, generator=generator, dtype=torch.float64)
    assert_agrees("gpu", case, shape, least_weight=0.03)


def test_on_the_faces_of_the_cube_and_outside() -> None:
    """A diagonal from corner to corner and beyond at both ends, and a ray along an edge."""
    case = random_case(SMALL, 3, rays=2)
    places = torch.tensor([-0.5, 0.0, 0.375, 1.0, 1.5, 0.0, 0.125, 1.0], dtype=torch.float64)
    case |= {"starts": torch.tensor([0, 5, 8]), "places": places, "lengths": 0.3 + 0.0 * places}
    case["origins"] = torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
    case["directions"] = torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    assert_agrees("gpu", case, SMALL)


def test_an_empty_field_is_transparent_and_has_no_gradient() -> None:
    case = random_case(SMALL, 5, rays=2)
    found = rendered("gpu", case, SMALL, shift=-200.0)
    assert not any(value.any() for value in found.values())


def test_no_rays_and_no_samples() -> None:
    case = random_case(SMALL, 5, rays=3, most=1)
    found = rendered("gpu", case, SMALL)
    assert set(found) == {*OUTPUTS, *(f"by {name}" for name in NAMES)}
    assert not any(value.any() for value in found.values())
    nothing = rendered("gpu", without_rays(case), SMALL)
    assert nothing["color"].shape == (0, 3) and not nothing["by colour"].any()


def test_a_ray_doesn_t_depend_on_the_others() -> None:
    case = random_case(SMALL, 5, rays=7)
    whole = seen_by(case)
    for ray in (1, 6):
        alone = seen_by(only_ray(case, ray))
        assert all(torch.equal(alone[name][0], whole[name][ray]) for name in OUTPUTS)


@pytest.mark.parametrize("name", ["density", "colour"])
def test_a_grid_that_is_not_finite_is_found_where_the_definition_finds_it(name: str) -> None:
    case = random_case(SMALL, 6, rays=5, longest=0.1)
    rank = {"density": SMALL.density_rank, "colour": SMALL.colour_rank}[name]
    SMALL.planes(case[name], rank)[1][2, 1, 3] = math.nan
    found, expected = seen_by(case), seen_by(case, "reference")
    assert any(value.isnan().any() and not value.isnan().all() for value in expected.values())
    assert all(torch.equal(found[one].isnan(), expected[one].isnan()) for one in OUTPUTS)


@pytest.mark.filterwarnings("ignore:invalid value encountered")  # by the interpreter
@pytest.mark.parametrize("name", ["origins", "directions", "places"])
@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_rays_that_lead_nowhere_see_nothing_that_is_a_number(name: str, value: float) -> None:
    case = random_case(SMALL, 1, rays=4)
    assert (case["starts"].diff()[1:] > 0).all()
    case[name][int(case["starts"][2]) if name == "places" else 2] = value
    for found in seen_by(case).values():
        assert found[2].isnan().all() and not found[[0, 1, 3]].isnan().any()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"density": torch.zeros(3)}, "density"),
        ({"views": torch.zeros(11, 2)}, "views"),
        ({"origins": torch.zeros(11, 3, dtype=torch.float64)}, "origins"),
        ({"lengths": torch.zeros(4)}, "lengths"),
        ({"starts": torch.zeros(12, dtype=torch.int32)}, "starts"),
        ({name: torch.zeros(0, 3) for name in ("origins", "directions", "views")} | {"starts": torch.zeros(1).long()},
         "without a ray"),
    ],
)  # fmt: skip
def test_wrong_tensors(change: dict[str, Tensor], expected: str) -> None:
    case = of_type(random_case(SMALL, 1), torch.float32)
    with pytest.raises(ValueError, match=expected):
        load("field", "gpu")(**{**case, **change}, shape=SMALL, shift=0.0)


@pytest.mark.parametrize(("ranks", "count"), [((8, 16), 0), ((8, 8), 1), ((16, 24), 40)])
def test_features_agree_with_the_definition(ranks: tuple[int, int], count: int) -> None:
    field_cases.assert_features_agree("gpu", GridShape((3, 5, 4), *ranks, 1), 1, count)


def test_wrong_tensors_of_features() -> None:
    of_points = load("field", "gpu", function="field_features")
    density, colour, points = torch.zeros(SMALL.density_size), torch.zeros(SMALL.colour_size), torch.zeros(4, 3)
    for wrong, expected in (
        ((colour[1:], colour, points), "field_features density"),
        ((density, colour.double(), points), "field colour"),
        ((density, colour, points[:, :2]), "field_features points"),
    ):
        with pytest.raises(ValueError, match=expected):
            of_points(*wrong, shape=SMALL)
    where_nothing_is = torch.tensor([[0.5, 0.5, 0.5], [0.5, math.nan, 0.5]])
    found = of_points(density, colour, where_nothing_is, shape=SMALL)
    assert torch.isfinite(found[0]).all() and torch.isnan(found[1]).all()


def test_wrong_tensors_of_density_and_samples() -> None:
    density = load("field", "gpu", function="field_density")
    with pytest.raises(ValueError, match="field_density points"):
        density(torch.zeros(SMALL.density_size), torch.zeros(4, 2), shape=SMALL, shift=0.0)
    (*rays, occupied), count = field_cases.marched(0)
    samples = load("field", "gpu", function="field_samples")
    with pytest.raises(ValueError, match="field_samples offsets"):
        samples(*rays[:3], torch.zeros(2), occupied, count=count)
    with pytest.raises(ValueError, match="field_samples occupied"):
        samples(*rays, occupied.float(), count=count)


def test_the_same_bits_twice() -> None:
    shape = GridShape((2, 3, 2), 8, 8, 1)
    case = random_case(shape, 7, rays=3)
    one, other = (rendered("gpu", case, shape) for _ in range(2))
    assert all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("seed", [0, 1])
def test_samples_lie_in_occupied_cells(seed: int) -> None:
    case, count = field_cases.marched(seed)
    expected = field_cases.samples_in_occupied_cells(case, count)
    assert expected is not None
    field_cases.assert_samples(load("field", "gpu", function="field_samples")(*case, count=count), expected)


def test_more_steps_than_a_program_looks_at_at_once() -> None:
    case, count = field_cases.marched(0)[0], 300
    found = load("field", "gpu", function="field_samples")(*(each[:3] for each in case[:4]), case[4], count=count)
    expected = load("field", "reference", function="field_samples")(
        *(each[:3] for each in case[:4]), case[4], count=count
    )
    assert torch.equal(found.starts, expected.starts) and torch.equal(found.places, expected.places)


@pytest.mark.filterwarnings("ignore:invalid value encountered")  # by the interpreter
@pytest.mark.parametrize("name", ["origins", "directions", "spans"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_samples_of_rays_that_lead_nowhere(name: str, value: float) -> None:
    (*rays, occupied), count = field_cases.marched(0)
    rays[("origins", "directions", "spans").index(name)][4, 1] = value
    with pytest.raises(FloatingPointError, match=name):
        load("field", "gpu", function="field_samples")(*rays, occupied, count=count)


def test_no_rays_have_no_samples() -> None:
    (*rays, occupied), count = field_cases.marched(0)
    found = load("field", "gpu", function="field_samples")(*(each[:0] for each in rays), occupied, count=count)
    assert found.starts.tolist() == [0] and found.places.shape == found.steps.shape == (0,)


def test_the_host_waits_for_the_number_of_samples_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    (*rays, occupied), count = field_cases.marched(0)
    shape = GridShape((2, 2, 2), 8, 8, 4)
    case = of_type(random_case(shape, 8, rays=2, most=5), torch.float32)
    with pretended(monkeypatch) as waits:
        there = {name: value.to("cuda") for name, value in case.items()}
        for name in NAMES:
            there[name] = there[name].detach().requires_grad_()
        seen = load("field")(**there, shape=shape, shift=-0.5)
        (seen.color.sum() + seen.distance.sum()).backward()
        load("field", function="field_density")(there["density"], there["origins"], shape=shape, shift=0.0)
        grids = there["density"], there["colour"]
        load("field", function="field_features")(*grids, there["origins"].detach(), shape=shape).sum().backward()
        assert waits == []
        load("field", function="field_samples")(*(each.to("cuda") for each in rays), occupied.to("cuda"), count=count)
        assert waits == ["_local_scalar_dense in gpu.py field_samples"]
