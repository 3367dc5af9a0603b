"""All of space in the cube: straight pieces of rays, where one point has one place."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tolerances import FLOAT32_GRADIENT, FLOAT64_VALUE, SAME_DEPTH, SEARCHED_PLACE
from torch import Tensor

from dofbench.training.fields.cube_rays import points_along
from dofbench.training.fields.unbounded import Unbounded

LOW, HIGH = np.array([-1.0, 2.0, 1.0]), np.array([1.0, 6.0, 5.0])
MIDDLE, HALF = torch.tensor([0.0, 4.0, 3.0]).double(), torch.tensor([1.0, 2.0, 2.0]).double()
SPACE = Unbounded(LOW, HIGH, 0.0)
PIECES = 4


def random_rays(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """From in and around the box, to everywhere."""
    generator = torch.Generator().manual_seed(seed)
    origins = MIDDLE + HALF * 4 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return origins, torch.randn(count, 3, generator=generator, dtype=torch.float64)


def longest(points: Tensor) -> Tensor:
    """(...,) how many times as large as the box another box is that has the points (..., 3) on its faces."""
    return ((points - MIDDLE) / HALF).abs().amax(-1)


def in_cube(point: Tensor, origin: Tensor, depth: float = 1.0) -> list[Tensor]:
    """Where the ray from `origin` that meets the point at this depth has it, for each piece that has it.

    A point where pieces meet, as on a diagonal of the box, is in each of them, wherever rounding puts their ends. A
    piece no longer than such a rounding isn't there.
    """
    rays = origin[None], (point - origin)[None] / depth
    found = []
    for number, piece in enumerate(SPACE.pieces(*rays)):
        begin, end = (float(place) for place in piece.spans[0])
        depths = [depth_of(rays, number, place) for place in (begin, end)]
        if begin < end and depths[0] < depths[1] * (1 - SAME_DEPTH):
            if not depths[0] * (1 - SAME_DEPTH) <= depth <= depths[1] * (1 + SAME_DEPTH):
                continue
            for _ in range(200):
                place = (begin + end) / 2
                begin, end = (place, end) if depth_of(rays, number, place) < depth else (begin, place)
            found.append(piece.points(piece.spans.new_full((1,), begin))[0])
    return found


def depth_of(rays: tuple[Tensor, Tensor], number: int, place: float, space: Unbounded = SPACE) -> float:
    return float(space.depths(*rays, torch.full((PIECES, 1), place, dtype=torch.float64))[number, 0])


def drawn_together(points: Tensor) -> Tensor:
    """(..., 3) in the cube, of points of the world (..., 3): the map itself, without rays."""
    units = (points - MIDDLE) / HALF
    size = units.abs().amax(-1, keepdim=True)
    return (torch.where(size < 1, 0.85 * units, units / (size + 1 / 0.85 - 1)) + 1) / 2


def there() -> st.SearchStrategy[Tensor]:
    """A point in the box or up to 12 of its half sides away."""
    return st.tuples(*[st.floats(-12, 12)] * 3).map(lambda xyz: MIDDLE + HALF * torch.tensor(xyz).double())


@pytest.mark.slow
@given(there(), st.lists(st.tuples(*[st.floats(-0.9, 0.9)] * 3), min_size=3, max_size=3), st.floats(0.1, 10))
@example(torch.tensor([7.875, 4, 18.75]).double(), [(0.0, -2.0, -1.5), (0.0, 0.0, 0.0), (0.3, 0.2, -0.1)], 1.0)
@example(torch.tensor([-3.0, -2, -3]).double(), [(0.0, 0.2569994330406189, -0.47850656509399414)] * 3, 7.59670880328224)
@example(
    torch.tensor([7.875, 19.75, 18.75]).double(),
    [(0.6401798129081726, -0.8245418071746826, 0.0)] * 3,
    6.061607471915015,
)
def test_a_point_has_one_place_whoever_sees_it(point: Tensor, within: list[tuple[float, ...]], depth: float) -> None:
    """From three places in the box."""
    seen = []
    for one in within:
        origin = MIDDLE + HALF * torch.tensor(one).double()
        if float((point - origin).norm()) > 0.01:
            found = in_cube(point, origin, depth)
            assert 1 <= len(found) <= 3  # two or three where pieces meet
            seen += found
    for other in seen:
        torch.testing.assert_close(other, seen[0], rtol=0, atol=SEARCHED_PLACE)
        assert 0 <= float(other.min()) and float(other.max()) <= 1


@pytest.mark.slow
@given(there(), there())
def test_a_point_beyond_the_box_has_that_place_from_outside_too(point: Tensor, towards: Tensor) -> None:
    """From any place whose ray comes nearest to the box before the point, not behind it."""
    origin = point + (MIDDLE + (towards - MIDDLE) / 12 - point) * 3
    before = origin + (point - origin) * torch.linspace(0, 1, 999, dtype=torch.float64)[:, None]
    if float(longest(point)) < 1.01 or float((point - origin).norm()) < 0.1 or longest(before).argmin() > 990:
        return
    found = in_cube(point, origin)
    assert found
    inner = in_cube(point, MIDDLE + 1e-3)[0]
    for one in found:
        torch.testing.assert_close(one, inner, rtol=0, atol=SEARCHED_PLACE)


def test_the_box_keeps_its_shape_and_infinity_is_the_surface() -> None:
    origins, directions = random_rays(500)
    inside, *beyond = SPACE.pieces(origins, directions)
    corners = [in_cube(MIDDLE + HALF * sign * 0.5, MIDDLE + 1e-3)[0] - 0.5 for sign in (1, -1)]
    assert float(corners[0].min()) == pytest.approx(float(corners[0].max()), abs=SEARCHED_PLACE)
    torch.testing.assert_close(corners[0], -corners[1], rtol=0, atol=SEARCHED_PLACE)
    ends = beyond[-1].points(beyond[-1].spans[:, 1])
    torch.testing.assert_close((ends - 0.5).abs().amax(1), torch.full((500,), 0.5).double(), rtol=0, atol=FLOAT64_VALUE)


def test_pieces_follow_one_another() -> None:
    """Each begins in the cube where the one before ends, those that aren't there left out, and at the same depth."""
    origins, directions = random_rays(300)
    pieces = SPACE.pieces(origins, directions)
    spans = torch.stack([piece.spans for piece in pieces])
    depths = [SPACE.depths(origins, directions, spans[..., end]) for end in (0, 1)]
    begins, ends = ([piece.points(piece.spans[:, end]) for piece in pieces] for end in (0, 1))
    counts = []
    for ray in range(300):
        # A piece so short that rounding decides whether it is there doesn't count.
        there = [k for k in range(PIECES) if float(spans[k, ray, 1] - spans[k, ray, 0]) > 1e-9]
        counts.append(len(there))
        for one, other in itertools.pairwise(there):
            torch.testing.assert_close(ends[one][ray], begins[other][ray], rtol=0, atol=SEARCHED_PLACE)
            assert float(depths[1][one, ray]) == pytest.approx(float(depths[0][other, ray]), rel=SEARCHED_PLACE)
        assert there[-1] == PIECES - 1 and float(spans[-1, ray, 1]) == 1
    assert set(counts) == {1, 2, 3, 4}  # all cases occur


def test_a_ray_that_misses_the_box_begins_where_it_is_nearest() -> None:
    origins, directions = random_rays(400, seed=3)
    pieces = SPACE.pieces(origins, directions)
    inside = pieces[0].spans[:, 0] < pieces[0].spans[:, 1]
    first = torch.stack([piece.spans[:, 0] for piece in pieces])
    depths = SPACE.depths(origins, directions, first)
    t = torch.linspace(0, 60, 60001, dtype=torch.float64)
    missed = 0
    for ray in torch.nonzero(~inside)[:, 0].tolist():
        sizes = longest(origins[ray] + t[:, None] * directions[ray])
        assert float(sizes.min()) >= 1 - FLOAT64_VALUE
        there = min(k for k in (1, 2, 3) if float(pieces[k].spans[ray, 1] - pieces[k].spans[ray, 0]) > 1e-9)
        assert longest(origins[ray] + depths[there, ray] * directions[ray]) <= sizes.min() + SEARCHED_PLACE
        missed += 1
    assert missed > 100


def test_a_ray_in_the_box_begins_at_its_camera_and_one_before_it_at_the_near_side() -> None:
    straight = torch.tensor([[0.0, 0.0, 1.0]]).double()
    for z, begin in ((3.5, 0.0), (-4.0, 5.0)):
        inside = SPACE.pieces(torch.tensor([[0.1, 4.2, z]]).double(), straight)[0]
        assert inside.spans[0].tolist() == pytest.approx([begin, 5 - z], abs=FLOAT64_VALUE)


def test_a_ray_that_leaves_the_box_behind_begins_at_its_camera() -> None:
    """And not where its line was nearest to the box, which is behind the camera."""
    camera = MIDDLE + HALF * torch.tensor([3.0, -1.0, 0.5]).double()
    pieces = SPACE.pieces(camera[None], HALF[None] * torch.tensor([[1.0, 0.2, 0.4]]).double())
    there = next(piece for piece in pieces if float(piece.spans[0, 1] - piece.spans[0, 0]) > 1e-9)
    (expected,) = in_cube(camera, MIDDLE)
    torch.testing.assert_close(there.points(there.spans[:, 0])[0], expected, rtol=0, atol=SEARCHED_PLACE)


@given(there(), st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0.1, 20))
def test_what_is_nearer_than_the_near_plane_is_not_there(
    camera: Tensor, direction: tuple[float, ...], near: float
) -> None:
    """What is farther away has the place that it has without such a plane, wherever the plane cuts the ray."""
    along = torch.tensor(direction).double() * HALF + 1e-3
    rays = camera[None], along[None]
    space = Unbounded(LOW, HIGH, near)
    whole, cut = SPACE.pieces(*rays), space.pieces(*rays)
    for number, (one, other) in enumerate(zip(whole, cut, strict=True)):
        begin, end = (depth_of(rays, number, float(place)) for place in one.spans[0])
        nearer, farther = (depth_of(rays, number, float(place), space) for place in other.spans[0])
        if float(one.spans[0, 1] - one.spans[0, 0]) > 1e-9 and end > near * 1.001:
            assert nearer == pytest.approx(max(begin, near), rel=SEARCHED_PLACE)
            assert farther == pytest.approx(end, rel=SEARCHED_PLACE)
            torch.testing.assert_close(one.points(one.ends), other.points(other.ends), rtol=0, atol=SEARCHED_PLACE)
        elif end < near * 0.999:
            assert float(other.spans[0, 1]) <= float(other.spans[0, 0])


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.5, 1.0, 1.0), (-0.5, 1.0, 0.0), (0.0, -1.0, 1.0)])
@pytest.mark.parametrize("origin", [(0.0, 4.0, 3.0), (0.0, 4.0, -9.0), (1.0, 6.0, 5.0), (30.0, 4.0, 3.0)])
def test_rays_along_axes_and_diagonals_are_finite(origin: tuple[float, ...], direction: tuple[float, ...]) -> None:
    """Where coordinates grow equally fast, or not at all; in float32, with gradients."""
    rays = torch.tensor([origin]).requires_grad_(), torch.tensor([direction]).requires_grad_()
    pieces = SPACE.pieces(*rays)
    total = sum(piece.origins.sum() + piece.directions.sum() for piece in pieces)
    places = torch.stack([piece.ends for piece in pieces])
    total = total + (1 / SPACE.depths(*rays, places)).clamp_max(9).sum()
    total.backward()
    for found in (total, *(ray.grad for ray in rays)):
        assert found is not None and bool(torch.isfinite(found).all())
    assert all(bool(torch.isfinite(piece.spans).all()) for piece in pieces)


def test_gradients_are_those_of_the_map_at_the_ends_depths() -> None:
    """Of both ends of every piece beyond the box, whose depths count as fixed; infinity's are those of the direction.
    An end lies where the map has a kink, so the map is that beyond the face that the piece's middle is beyond."""
    origins, directions = (one.requires_grad_() for one in random_rays(300, seed=1))
    pieces = SPACE.pieces(origins, directions)
    weights = torch.randn(300, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    depths = [SPACE.depths(origins, directions, torch.full((PIECES, 300), at).double()).detach() for at in (0, 0.5, 1)]
    finite = 0
    for number, piece in list(enumerate(pieces))[1:]:
        middle = (origins + depths[1][number, :, None] * directions - MIDDLE) / HALF
        axis = middle.abs().argmax(1, keepdim=True)
        for side, depth in ((0, depths[0][number]), (1, depths[2][number])):
            there = (piece.spans[:, 1] > piece.spans[:, 0]) & (1e-3 < depth) & (depth < 1e3)
            finite += int(there.sum())
            units = (origins + depth[:, None] * directions - MIDDLE) / HALF
            size = (middle.sign() * units).gather(1, axis)
            expected = (weights * (units / (size + 1 / 0.85 - 1) + 1) / 2)[there].sum()
            found = (weights * piece.points(piece.spans[:, side]))[there].sum()
            for one, other in zip(*(gradients(total, origins, directions) for total in (found, expected)), strict=True):
                torch.testing.assert_close(one, other, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)
    assert finite > 400
    last = (weights * pieces[-1].points(pieces[-1].spans[:, 1])).sum()
    units = directions / HALF
    infinite = (weights * units / units.abs().amax(1, keepdim=True)).sum() / 2
    for one, other in zip(*(gradients(total, origins, directions) for total in (last, infinite)), strict=True):
        torch.testing.assert_close(one, other, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)


def gradients(total: Tensor, *by: Tensor) -> list[Tensor]:
    found = torch.autograd.grad(total, by, retain_graph=True, allow_unused=True, materialize_grads=True)
    return list(found)


@settings(max_examples=100)
@given(st.integers(0, 99999), st.floats(0.01, 0.99), st.floats(0, 5))
def test_a_place_is_where_the_map_has_its_depth(seed: int, share: float, near: float) -> None:
    """Of every piece, with the gradients of both."""
    space = Unbounded(LOW, HIGH, near)
    origins, directions = (one.requires_grad_() for one in random_rays(20, seed))
    pieces = space.pieces(origins, directions)
    places = torch.stack([piece.spans[:, 0] + share * (piece.ends - piece.spans[:, 0]) for piece in pieces]).detach()
    depths = space.depths(origins, directions, places)
    for piece, place, depth in zip(pieces, places, depths, strict=True):
        there = (piece.spans[:, 1] - piece.spans[:, 0] > 1e-6) & (depth.detach() < 1e3)  # farther away it is capped
        found = piece.points(place)[there]
        expected = drawn_together(origins + depth[:, None] * directions)[there]
        torch.testing.assert_close(found, expected, rtol=0, atol=FLOAT64_VALUE)
        weights = torch.linspace(-1, 2, found.numel(), dtype=torch.float64).view(found.shape)
        sums = (weights * found).sum(), (weights * expected).sum()
        for one, other in zip(*(gradients(total, origins, directions) for total in sums), strict=True):
            torch.testing.assert_close(one, other, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)


def test_rays_along_a_face_have_places_as_exact_as_any() -> None:
    """In float32, and gradients no larger than those of other rays: their distance from the box hardly changes."""
    slopes = 10.0 ** -torch.arange(1, 8).double()
    origins = (MIDDLE + HALF * torch.tensor([-3.0, 1.5, 0.2]).double()).repeat(7, 1)
    directions = HALF * torch.stack([torch.ones(7).double(), slopes, slopes / 3], 1)
    found = []
    for kind in (torch.float32, torch.float64):
        rays = origins.to(kind).requires_grad_(), directions.to(kind).requires_grad_()
        points = points_along(SPACE.pieces(*rays), torch.linspace(0.05, 0.95, 19, dtype=kind))
        points.sum().backward()
        found.append((points.detach().double(), *(ray.grad.double() for ray in rays if ray.grad is not None)))
    for single, double in zip(*found, strict=True):
        torch.testing.assert_close(single, double, rtol=FLOAT32_GRADIENT, atol=FLOAT32_GRADIENT)
        assert float(double.abs().max()) < 100


def test_length_is_that_in_the_cube_by_the_sides_of_the_box() -> None:
    """A hundred is the cube's diagonal."""
    pieces = SPACE.pieces(*random_rays(50))
    for piece in pieces:
        measured = (piece.directions * HALF).norm(dim=1) / HALF.norm()
        torch.testing.assert_close(piece.gain, 100 * measured, rtol=FLOAT64_VALUE, atol=0)


def test_nodes_follow_the_sides() -> None:
    assert Unbounded(np.zeros(3), np.array([1.0, 2.0, 4.0]), 0.0).nodes(80) == (20, 40, 80)
    assert math.prod(SPACE.nodes(8)) == 4 * 8 * 8
