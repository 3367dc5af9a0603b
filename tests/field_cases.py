"""Cases of the radiance field, and what each backend must make of them."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tolerances import AT_A_THRESHOLD, FLOAT32_GRADIENT, FLOAT32_SCALAR, FLOAT32_VALUE, FLOAT64_VALUE
from torch import Tensor

from dofbench.runtime.factored_grid import MODES, GridShape, RaySamples
from dofbench.runtime.ops import load

SMALL = GridShape((3, 4, 5), 8, 8, 4)
NAMES = ("density", "colour", "basis", "origins", "directions", "views")


def dtype_of(backend: str) -> torch.dtype:
    """The type that a backend is tested with."""
    return torch.float64 if backend == "reference" else torch.float32


def of_type(case: dict[str, Tensor], dtype: torch.dtype) -> dict[str, Tensor]:
    """The case with its floating numbers in another type."""
    return {name: value.to(dtype) if value.is_floating_point() else value for name, value in case.items()}


def random_case(shape: GridShape, seed: int, rays: int = 11, most: int = 21, longest: float = 1.0) -> dict[str, Any]:
    """Rays that begin in the cube, some of which leave it, with up to `most` samples each, float64."""
    generator = torch.Generator().manual_seed(seed)

    def drawn(*size: int) -> Tensor:
        return torch.rand(*size, generator=generator, dtype=torch.float64)

    counts = torch.randint(0, most, (rays,), generator=generator)
    counts[0] = 0  # a ray without samples
    places = [drawn(count).sort().values for count in counts.tolist()]
    return {
        "density": 2 * drawn(shape.density_size) - 1,
        "colour": 2 * drawn(shape.colour_size) - 1,
        "basis": 2 * drawn(*shape.basis_shape) - 1,
        "origins": drawn(rays, 3),
        "directions": drawn(rays, 3) - 0.5,
        "views": torch.nn.functional.normalize(drawn(rays, 3) - 0.5, dim=1),
        "starts": torch.cat([torch.zeros(1, dtype=torch.long), counts.cumsum(0)]),
        "places": torch.cat(places),
        "lengths": longest * drawn(int(counts.sum())),
    }


def only_ray(case: dict[str, Any], ray: int) -> dict[str, Any]:
    """The case without the other rays."""
    begin, end = case["starts"][ray : ray + 2].tolist()
    return {
        **case,
        **{name: case[name][ray : ray + 1] for name in ("origins", "directions", "views")},
        "starts": torch.tensor([0, end - begin]),
        **{name: case[name][begin:end] for name in ("places", "lengths")},
    }


def without_rays(case: dict[str, Any]) -> dict[str, Any]:
    """The case with no ray and no sample at all."""
    rays = {name: case[name][:0] for name in ("origins", "directions", "views", "places", "lengths")}
    return {**case, **rays, "starts": torch.zeros(1).long()}


def homogeneous(density: float, colour: tuple[float, ...]) -> dict[str, Tensor]:
    """Tensors of a fog of one density and colour: the first channel of the first mode is the whole function."""
    grids = {"density": torch.zeros(SMALL.density_size), "colour": torch.zeros(SMALL.colour_size)}
    for flat, value in ((grids["density"], math.log(math.expm1(density))), (grids["colour"], 1.0)):
        SMALL.planes(flat, 8)[0][..., 0] = value
        SMALL.lines(flat, 8)[0][..., 0] = 1.0
    basis = torch.zeros(SMALL.basis_shape)
    constant = 0.5 / math.sqrt(math.pi)  # the first spherical harmonic
    basis[0, :: SMALL.harmonics] = torch.logit(torch.tensor(colour)) / constant
    return {**grids, "basis": basis}


def near_a_threshold(case: dict[str, Any], shape: GridShape, least_weight: float) -> bool:
    """Whether rounding may decide if a sample has a colour, or is seen at all."""
    ray = torch.repeat_interleave(torch.arange(len(case["origins"])), case["starts"].diff())
    points = case["origins"][ray] + case["places"][:, None] * case["directions"][ray]
    density = load("field", "reference", function="field_density")(case["density"], points, shape=shape, shift=-0.5)
    left = 1.0
    for s in range(len(ray)):
        left = left if s and ray[s] == ray[s - 1] else 1.0
        weight = left * -math.expm1(-float(density[s] * case["lengths"][s]))
        if any(
            abs(value / limit - 1) < AT_A_THRESHOLD for value, limit in ((left, 1e-4), (weight, least_weight)) if limit
        ):
            return True
        left -= weight
    return False


def rendered(backend: str, case: dict[str, Any], shape: GridShape, **options: float) -> dict[str, Tensor]:
    """Outputs, and gradients of a random sum of them by all that has one, float64."""
    dtype = dtype_of(backend)
    tensors = of_type(case, dtype)
    for name in NAMES:
        tensors[name] = tensors[name].clone().requires_grad_()
    seen = load("field", backend)(**tensors, shape=shape, **{"shift": -0.5, **options})
    outputs = {"color": seen.color, "opacity": seen.opacity, "distance": seen.distance}
    generator = torch.Generator().manual_seed(1)
    total = sum(
        (value * torch.rand(value.shape, generator=generator, dtype=torch.float64).to(dtype)).sum()
        for value in outputs.values()
    )
    found = torch.autograd.grad(total, [tensors[name] for name in NAMES], allow_unused=True)
    outputs |= {f"by {name}": by for name, by in zip(NAMES, found, strict=True) if by is not None}
    return {name: value.detach().double() for name, value in outputs.items()}


def assert_agrees(backend: str, case: dict[str, Any], shape: GridShape, **options: float) -> None:
    """Values and gradients against the definition's, relative to the largest magnitude."""
    found, expected = (rendered(name, case, shape, **options) for name in (backend, "reference"))
    assert set(expected) <= set(found)
    for name, value in expected.items():
        rounding = FLOAT32_GRADIENT if name.startswith("by") else FLOAT32_VALUE
        assert float((found[name] - value).abs().max()) <= rounding * float(value.abs().max()), name


def assert_fog_follows_beer_and_lambert(backend: str) -> None:
    """Opacity, colour and mean place of a fog of one density."""
    colour, density, lengths = (0.2, 0.5, 0.9), 3.0, torch.tensor([0.1, 0.4, 0.05, 0.2])
    places = torch.tensor([0.1, 0.35, 0.6, 0.8])
    ray = torch.tensor([[0.1, 0.2, 0.3]])
    case = {
        **homogeneous(density, colour),
        "origins": ray,
        "directions": ray,
        "views": torch.nn.functional.normalize(ray, dim=1),
        "starts": torch.tensor([0, 4]),
        "places": places,
        "lengths": lengths,
    }
    seen = load("field", backend)(**of_type(case, dtype_of(backend)), shape=SMALL, shift=0.0)
    opacity = 1 - math.exp(-density * float(lengths.sum()))
    assert float(seen.opacity) == pytest.approx(opacity, rel=FLOAT32_VALUE)
    assert seen.color[0].tolist() == pytest.approx([opacity * value for value in colour], rel=FLOAT32_VALUE)
    passed = [math.exp(-density * float(lengths[:k].sum())) for k in range(5)]
    distance = sum(float(places[k]) * (passed[k] - passed[k + 1]) for k in range(4))
    assert float(seen.distance) == pytest.approx(distance, rel=FLOAT32_VALUE)


def assert_planes_times_lines_are_interpolated(backend: str) -> None:
    """f(x, y, z) = the products of coordinates, which trilinear interpolation repeats exactly, one for each mode."""
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    along = [torch.linspace(0, 1, nodes, dtype=torch.float64) for nodes in SMALL.nodes]
    for mode, (column, row, axis) in enumerate(MODES):
        flat = torch.zeros(SMALL.density_size, dtype=torch.float64)
        SMALL.planes(flat, 8)[mode][..., 5] = along[row][:, None] * (1 + along[column])
        SMALL.lines(flat, 8)[mode][..., 5] = 2 - along[axis]
        dtype = dtype_of(backend)
        found = load("field", backend, function="field_density")(
            flat.to(dtype), points.to(dtype), shape=SMALL, shift=0.25
        )
        feature = points[:, row] * (1 + points[:, column]) * (2 - points[:, axis])
        expected = torch.log1p(torch.exp(feature + 0.25))
        tolerance = FLOAT64_VALUE if dtype == torch.float64 else FLOAT32_VALUE
        torch.testing.assert_close(found.double(), expected, rtol=tolerance, atol=0)


def features(backend: str, shape: GridShape, seed: int, count: int = 50) -> dict[str, Tensor]:
    """`field_features` at random points, some outside the cube, and the gradients of a random sum of it, float64."""
    case = of_type(random_case(shape, seed), dtype_of(backend))
    points = 1.4 * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) - 0.2
    grids = [case[name].requires_grad_() for name in ("density", "colour")]
    found = load("field", backend, function="field_features")(*grids, points.to(grids[0].dtype), shape=shape)
    weights = torch.rand(found.shape, generator=torch.Generator().manual_seed(1))
    by_density, by_colour = torch.autograd.grad((found * weights.to(found.dtype)).sum(), grids)
    outputs = {"features": found, "by density": by_density, "by colour": by_colour}
    return {name: value.detach().double() for name, value in outputs.items()}


def assert_features_agree(backend: str, shape: GridShape, seed: int, count: int = 50) -> None:
    """With the definition's, value and gradient, relative to the largest magnitude."""
    found, expected = (features(name, shape, seed, count) for name in (backend, "reference"))
    for name, value in expected.items():
        rounding = FLOAT32_GRADIENT if name.startswith("by") else FLOAT32_VALUE
        assert found[name].shape == value.shape
        largest = float(value.abs().max()) if len(value) else 0.0
        torch.testing.assert_close(found[name], value, rtol=0, atol=rounding * largest)


def assert_features_are_planes_times_lines(backend: str) -> None:
    """As torch samples a picture: the density's channels mode by mode, then the colour's; points outside as on the
    border."""
    shape, dtype = GridShape((3, 4, 5), 8, 16, 4), dtype_of(backend)
    case, generator = of_type(random_case(shape, 3), dtype), torch.Generator().manual_seed(0)
    points = (1.4 * torch.rand(40, 3, generator=generator) - 0.2).to(dtype)
    expected = []
    for flat, rank in ((case["density"], 8), (case["colour"], 16)):
        for (column, row, axis), plane, line in zip(MODES, *shape.parts(flat, rank), strict=True):
            where, along = 2 * points[:, [column, row]] - 1, 2 * points[:, axis] - 1
            whole = torch.einsum("ijc,kc->ckij", plane, line)[None]
            place = torch.cat([where, along[:, None]], 1)[None, None, None]
            sampled = torch.nn.functional.grid_sample(whole, place, padding_mode="border", align_corners=True)
            expected.append(sampled[0, :, 0, 0].T)
    found = load("field", backend, function="field_features")(case["density"], case["colour"], points, shape=shape)
    rounding = FLOAT64_VALUE if dtype == torch.float64 else FLOAT32_VALUE
    torch.testing.assert_close(found, torch.cat(expected, 1), rtol=0, atol=rounding)


def assert_points_outside_count_as_on_the_border(backend: str) -> None:
    """Of the density."""
    flat = torch.rand(SMALL.density_size, generator=torch.Generator().manual_seed(0)).to(dtype_of(backend))
    points = torch.tensor([[-0.5, 0.3, 1.7], [0.2, 7.0, -9.0]]).to(dtype_of(backend))
    density = load("field", backend, function="field_density")
    inside = density(flat, points.clamp(0, 1), shape=SMALL, shift=0.0)
    assert torch.equal(density(flat, points, shape=SMALL, shift=0.0), inside)


def assert_what_lies_behind_a_wall_has_no_gradient(backend: str) -> None:
    """The wall leaves 1e-5 of the light, less than the least transmittance; with half its length, 3e-3."""
    for length, seen in ((3.84, False), (1.92, True)):
        tensors = homogeneous(3.0, (0.3, 0.3, 0.3))
        places = torch.tensor([0.1, 0.9])
        rays = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
        tensors["colour"].requires_grad_()
        found = load("field", backend)(
            **tensors,
            origins=rays[:1],
            directions=rays[1:],
            views=torch.tensor([[0.0, 0.0, 1.0]]),
            starts=torch.tensor([0, 2]),
            places=places,
            lengths=torch.tensor([length, 1.0]),
            shape=SMALL,
            shift=0.0,
        )
        found.color.sum().backward()
        far = SMALL.planes(tensors["colour"].grad, 8)[0][-1, -1]  # beside the second sample alone
        assert bool(far.any()) == seen


def assert_thin_fog_keeps_its_digits(backend: str) -> None:
    """A density of 1e-6 over a length of 1e-3 is no difference of numbers near 1."""
    density = load("field", backend, function="field_density")
    flat = torch.zeros(SMALL.density_size)
    found = density(flat, torch.zeros(1, 3), shape=SMALL, shift=math.log(1e-6))
    assert float(found) == pytest.approx(1e-6, rel=FLOAT32_SCALAR)
    case = of_type(random_case(SMALL, 1), torch.float32)
    case |= {"density": flat, "starts": torch.tensor([0, *[1] * 11]), "places": torch.zeros(1)}
    seen = load("field", backend)(**{**case, "lengths": torch.full((1,), 1e-3)}, shape=SMALL, shift=math.log(1e-6))
    assert float(seen.opacity[0]) == pytest.approx(1e-9, rel=FLOAT32_SCALAR)


def marched(seed: int) -> tuple[tuple[Tensor, ...], int]:
    """The arguments of `field_samples`, float32, for rays some of which end before they begin; steps of a ray."""
    generator = torch.Generator().manual_seed(seed)
    rays, count = 9, 23
    occupied = torch.rand(4, 5, 6, generator=generator) > 0.5
    origins, directions = torch.rand(rays, 3, generator=generator), torch.rand(rays, 3, generator=generator) - 0.5
    spans, offsets = torch.rand(rays, 2, generator=generator), torch.rand(rays, generator=generator)
    return (origins, directions, spans, offsets, occupied), count


def samples_in_occupied_cells(case: tuple[Tensor, ...], count: int) -> list[tuple[int, float, float]] | None:
    """(ray, place, step) of each sample, by a loop over steps; None where one lies an eps from a cell's border."""
    origins, directions, spans, offsets, occupied = case
    found: list[tuple[int, float, float]] = []
    for ray in range(len(origins)):
        begin, end = spans[ray].tolist()
        for k in range(count if end > begin else 0):
            place = begin + (k + float(offsets[ray])) * (end - begin) / count
            point = [float(origins[ray, axis]) + place * float(directions[ray, axis]) for axis in range(3)]
            scaled = [min(max(p, 0), 1) * cells for p, cells in zip(point, (6, 5, 4), strict=True)]
            if not all(abs(value - round(value)) > FLOAT32_VALUE or value == round(value) for value in scaled):
                return None
            x, y, z = (min(int(value), cells - 1) for value, cells in zip(scaled, (6, 5, 4), strict=True))
            if occupied[z, y, x]:
                found.append((ray, place, (end - begin) / count))
    return found


def assert_samples(found: RaySamples, expected: list[tuple[int, float, float]]) -> None:
    """That they are these."""
    rays = len(found.starts) - 1
    assert found.starts.diff().tolist() == [sum(ray == r for ray, _, _ in expected) for r in range(rays)]
    assert found.places.tolist() == pytest.approx([place for _, place, _ in expected], abs=FLOAT32_VALUE)
    assert found.steps.tolist() == pytest.approx([step for _, _, step in expected], abs=FLOAT32_VALUE)


CLOSED_FORMS = (
    assert_fog_follows_beer_and_lambert,
    assert_planes_times_lines_are_interpolated,
    assert_points_outside_count_as_on_the_border,
    assert_features_are_planes_times_lines,
)
COMPILED = (assert_what_lies_behind_a_wall_has_no_gradient, assert_thin_fog_keeps_its_digits)
