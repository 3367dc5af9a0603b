"""All of space in the cube: straight pieces of rays, where one point has one place."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE, SEARCHED_PLACE
from torch import Tensor

from dofbench.fields.unbounded import Unbounded

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
    """Where the ray from `origin` that meets the point at this depth has it, for each piece that has it."""
    rays = origin[None], (point - origin)[None] / depth
    found = []
    for number, piece in enumerate(SPACE.pieces(*rays)):
        begin, end = (float(place) for place in piece.spans[0])
        depths = [depth_of(rays, number, place) for place in (begin, end)]
        if begin < end and depths[0] <= depth <= depths[1]:
            for _ in range(200):
                place = (begin + end) / 2
                begin, end = (place, end) if depth_of(rays, number, place) < depth else (begin, place)
            found.append(piece.points(piece.spans.new_full((1,), begin))[0])
    return found


def depth_of(rays: tuple[Tensor, Tensor], number: int, place: float) -> float:
    return float(SPACE.depths(*rays, torch.full((PIECES, 1), place, dtype=torch.float64))[number, 0])


def there() -> st.SearchStrategy[Tensor]:
    """A point in the box or up to 12 of its half sides away."""
    return st.tuples(*[st.floats(-12, 12)] * 3).map(lambda xyz: MIDDLE + HALF * torch.tensor(xyz).double())


@given(there(), st.lists(st.tuples(*[st.floats(-0.9, 0.9)] * 3), min_size=3, max_size=3), st.floats(0.1, 10))
def test_a_point_has_one_place_whoever_sees_it(point: Tensor, within: list[tuple[float, ...]], depth: float) -> None:
    """From three places in the box."""
    seen = []
    for one in within:
        origin = MIDDLE + HALF * torch.tensor(one).double()
        if float((point - origin).norm()) > 0.01:
            found = in_cube(point, origin, depth)
            assert 1 <= len(found) <= 2  # two where pieces meet
            seen += found
    for other in seen:
        torch.testing.assert_close(other, seen[0], rtol=0, atol=SEARCHED_PLACE)
        assert 0 <= float(other.min()) and float(other.max()) <= 1


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
    whole, cut = SPACE.pieces(*rays), Unbounded(LOW, HIGH, near).pieces(*rays)
    for number, (one, other) in enumerate(zip(whole, cut, strict=True)):
        begin, end = (depth_of(rays, number, float(place)) for place in one.spans[0])
        nearer, farther = (depth_of(rays, number, float(place)) for place in other.spans[0])
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


def test_gradients_reach_the_rays() -> None:
    origins, directions = (one.requires_grad_() for one in random_rays(5, seed=1))
    places = torch.stack([piece.spans.mean(1) for piece in SPACE.pieces(origins, directions)])

    def mapped(o: Tensor, d: Tensor) -> tuple[Tensor, ...]:
        pieces = SPACE.pieces(o, d)
        return *(piece.origins for piece in pieces), *(piece.directions for piece in pieces), SPACE.depths(o, d, places)

    assert torch.autograd.gradcheck(mapped, (origins, directions))


def test_length_is_that_in_the_cube_by_the_sides_of_the_box() -> None:
    """A hundred is the cube's diagonal."""
    pieces = SPACE.pieces(*random_rays(50))
    for piece in pieces:
        measured = (piece.directions * HALF).norm(dim=1) / HALF.norm()
        torch.testing.assert_close(piece.gain, 100 * measured, rtol=FLOAT64_VALUE, atol=0)


def test_nodes_follow_the_sides() -> None:
    assert Unbounded(np.zeros(3), np.array([1.0, 2.0, 4.0]), 0.0).nodes(80) == (20, 40, 80)
    assert math.prod(SPACE.nodes(8)) == 4 * 8 * 8
