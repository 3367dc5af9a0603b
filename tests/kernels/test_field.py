"""The radiance field on a factorised grid: closed forms, the definition's gradient, the CPU backend against it."""

from __future__ import annotations

import math
from collections.abc import Callable

import field_cases
import pytest
import torch
from backends import compiled, every
from field_cases import NAMES, SMALL, dtype_of, near_a_threshold, of_type, only_ray, random_case, rendered, without_rays
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from tolerances import FINITE_DIFFERENCE
from torch import Tensor

from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.ops import load


@every
@pytest.mark.parametrize("check", field_cases.CLOSED_FORMS)
def test_closed_forms(backend: str, check: Callable[[str], None]) -> None:
    check(backend)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([(8, 8), (8, 16), (16, 24)]), st.sampled_from([0, 1, 50, 1100]))
def test_features_agree_with_the_definition(seed: int, ranks: tuple[int, int], count: int) -> None:
    field_cases.assert_features_agree("cpu", GridShape((3, 9, 6), *ranks, 1), seed, count)


@settings(max_examples=5)
@given(st.integers(0, 2**31), st.sampled_from([1, 4, 9]))
def test_gradient_of_the_definition(seed: int, harmonics: int) -> None:
    shape = GridShape((2, 3, 4), 8, 8, harmonics)
    case = random_case(shape, seed, rays=3, most=4)
    tensors = [case[name].requires_grad_() for name in NAMES]

    def outputs(*values: Tensor) -> tuple[Tensor, ...]:
        seen = load("field", "reference")(**{**case, **dict(zip(NAMES, values, strict=True))}, shape=shape, shift=0.0)
        return seen.color, seen.opacity, seen.distance

    torch.autograd.gradcheck(outputs, tensors, atol=FINITE_DIFFERENCE, fast_mode=True)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 2**31),
    st.sampled_from([(8, 8, 1), (8, 16, 4), (16, 24, 9)]),
    st.sampled_from([0.1, 1.0, 30.0]),
    st.sampled_from([0.0, 1e-3]),
)
@example(8437389, (8, 8, 1), 30.0, 0.0)  # opaque rays, whose gradient by the density nearly cancels
def test_the_cpu_agrees_with_the_definition(seed: int, sizes: tuple, longest: float, least_weight: float) -> None:
    shape = GridShape((3, 9, 6), *sizes)
    case = random_case(shape, seed, longest=longest)
    assume(not near_a_threshold(case, shape, least_weight))
    field_cases.assert_agrees("cpu", case, shape, least_weight=least_weight)


@compiled
@pytest.mark.parametrize("check", field_cases.COMPILED)
def test_digits_and_hidden_samples(backend: str, check: Callable[[str], None]) -> None:
    check(backend)


def test_a_ray_doesn_t_depend_on_the_others() -> None:
    case = random_case(SMALL, 5, rays=40)
    whole = rendered("cpu", case, SMALL)
    for ray in (1, 17, 39):
        alone = rendered("cpu", only_ray(case, ray), SMALL)
        for name in ("color", "opacity", "distance"):
            assert torch.equal(alone[name][0], whole[name][ray])


def test_no_rays_and_no_samples() -> None:
    case = random_case(SMALL, 5, rays=3, most=1)
    found = rendered("cpu", case, SMALL)
    assert not found["color"].any() and not found["by density"].any() and not found["by origins"].any()
    assert rendered("cpu", without_rays(case), SMALL)["color"].shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"density": torch.zeros(3)}, "density"),
        ({"views": torch.zeros(11, 2)}, "views"),
        ({"origins": torch.zeros(11, 3, dtype=torch.float64)}, "origins"),
        ({"starts": torch.zeros(12).long()}, "starts"),
        ({"starts": torch.zeros(12, dtype=torch.int32)}, "starts"),
    ],
)
def test_wrong_tensors(change: dict[str, Tensor], expected: str) -> None:
    case = of_type(random_case(SMALL, 1), torch.float32)
    with pytest.raises(ValueError, match=expected):
        load("field", "cpu")(**{**case, **change}, shape=SMALL, shift=0.0)


def test_wrong_tensors_of_features() -> None:
    of_points = load("field", "cpu", function="field_features")
    density, colour, points = torch.zeros(SMALL.density_size), torch.zeros(SMALL.colour_size), torch.zeros(4, 3)
    for wrong, expected in (
        ((colour[1:], colour, points), "density"),
        ((density, colour.double(), points), "colour"),
        ((density, colour, points[:, :2]), "points"),
    ):
        with pytest.raises(ValueError, match=expected):
            of_points(*wrong, shape=SMALL)
    with pytest.raises(FloatingPointError, match="points"):
        of_points(density, colour, points / 0, shape=SMALL)


@pytest.mark.parametrize("name", ["origins", "directions", "places"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_rays_that_lead_nowhere(name: str, value: float) -> None:
    case = of_type(random_case(SMALL, 1), torch.float32)
    case[name].reshape(-1)[4] = value
    with pytest.raises(FloatingPointError, match=name):
        load("field", "cpu")(**case, shape=SMALL, shift=0.0)


@pytest.mark.parametrize(
    ("sizes", "match"),
    [(((1, 4, 4), 8, 8, 1), "nodes"), (((4, 4, 4), 8, 12, 1), "colour"), (((4, 4, 4), 8, 8, 2), "harm")],
)
def test_wrong_shapes(sizes: tuple, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        GridShape(*sizes)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31))
def test_samples_lie_in_occupied_cells(seed: int) -> None:
    """The CPU's are the definition's, and those of a loop over cells; places an eps from a cell's border excepted."""
    case, count = field_cases.marched(seed)
    expected = field_cases.samples_in_occupied_cells(case, count)
    assume(expected is not None)
    for backend in ("cpu", "reference"):
        tensors = (tensor if tensor.dtype == torch.bool else tensor.to(dtype_of(backend)) for tensor in case)
        found = load("field", backend, function="field_samples")(*tensors, count=count)
        field_cases.assert_samples(found, expected)
