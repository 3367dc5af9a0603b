"""Whether photographs can rank lenses, on scenes where the answer is known."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from known_scene import CAMERA, WIDTH, Known
from made_up import frontal
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.photographs import lens_evidence
from dofbench.evaluation.scoring.photographs.lens_evidence import (
    Seen,
    cannot_rank,
    energies,
    energy_share,
    seen_share,
)
from dofbench.evaluation.scoring.photographs.predict import predict
from dofbench.evaluation.scoring.photographs.search import QUICK
from dofbench.optics.defocus import defocus_numpy

NEAR, FAR = 2.0, 6.0  # depths of two layers, scene units
WIDE, CLOSED = PhysicalLens(9.0, 1 / NEAR, WIDTH), PhysicalLens(0.05, 1 / NEAR, WIDTH)  # far layer: 3 px, 0.02 px
ERROR = np.random.default_rng(0).normal(0, 0.02, (CAMERA.height, CAMERA.width, 3)).astype(np.float32)


def layered(camera: Camera, near: float = NEAR, far: float = FAR) -> Rendering:
    """A textured square in front of a textured wall."""
    x, y = np.meshgrid(*camera.rays(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5))
    inside = np.maximum(np.abs(near * x + camera.centre[0]), np.abs(near * y + camera.centre[1])) < 0.4 * near / NEAR
    depth = np.where(inside, near, far)
    u, v = (depth * side + place for side, place in zip((x, y), camera.centre[:2], strict=True))
    waves = [np.sin(22 * u + 5 * v + c) * np.cos(19 * v - (4 + 2 * c) * u) for c in range(3)]
    return Rendering((0.5 + 0.4 * np.stack(waves, axis=2)).astype(np.float32), depth.astype(np.float32))


class Layers(Known):
    """A method that knows the layered scene but for an error of its own."""

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        found = layered(camera)
        image = found.image if lens is None else defocus_numpy(found.image, found.depth, lens)[0]
        return Rendering(image + ERROR, found.depth)


def share_through(lens: PhysicalLens) -> float:
    photograph = defocus_numpy(layered(CAMERA).image, layered(CAMERA).depth, lens)[0]
    found = predict(Layers(), CAMERA, photograph, lens.aperture, QUICK)
    return energy_share([energies(found.picture, found.sharp, photograph, found.tiles.scored)])


def seen_from(places: list[float], lens: PhysicalLens, near: float = NEAR, far: float = FAR) -> float:
    cameras = [replace(CAMERA, world_to_camera=frontal(1, 1, 1.0, (x, 0.0, 0.0)).world_to_camera) for x in places]
    return seen_share([Seen(camera, lens, layered(camera, near, far).depth) for camera in cameras])


NEIGHBOURS = [0.0, 0.1, 0.2, 0.3]  # scene units apart: 1° to 8° at these depths


def test_a_wide_lens_on_layers_can_rank() -> None:
    energy, seen = share_through(WIDE), seen_from(NEIGHBOURS, WIDE)
    assert energy > 50 and 60 < seen < 95, "the square is in focus"
    assert cannot_rank(energy, seen) == ""


def test_a_closed_lens_cannot() -> None:
    energy, seen = share_through(CLOSED), seen_from(NEIGHBOURS, CLOSED)
    assert energy < 1 and seen == 0
    assert "0 % of the pixels (10 % are needed)" in cannot_rank(energy, seen)


def test_a_far_plane_without_parallax_cannot() -> None:
    lens = replace(WIDE, focus_disparity=1.0)  # circles of 9 px all over the plane
    far = 1e4
    seen = seen_from(NEIGHBOURS, lens, far, far)
    assert seen == 0 and seen_from([0.0] * 4, lens) == 0, "nor do photographs from one place"
    assert cannot_rank(99.0, seen)


@pytest.mark.parametrize(
    ("places", "there"),
    [([0.0, 0.1], False), ([0.0, 0.1, 0.2], True), ([0.0, 2.0, 4.0], False), ([0.0, 0.1, 4.0], False)],
    ids=["two views", "three", "far apart", "two of three together"],
)
def test_three_views_near_each_other_are_needed(places: list[float], there: bool) -> None:
    assert (seen_from(places, WIDE) > 50) == there


def test_depth_that_contradicts_itself_is_not_seen() -> None:
    cameras = [frontal(WIDTH, 80, 90.0, (x, 0.0, 0.0)) for x in NEIGHBOURS]
    views = [Seen(camera, WIDE, layered(camera).depth * (1 + 0.1 * i)) for i, camera in enumerate(cameras)]
    assert seen_share(views) < 5


def test_masked_pixels_are_neither_counted_nor_seen() -> None:
    cameras = [frontal(WIDTH, 80, 90.0, (x, 0.0, 0.0)) for x in NEIGHBOURS]
    far = [np.abs(layered(camera).depth - FAR) < 1e-3 for camera in cameras]
    views = [Seen(camera, WIDE, layered(camera).depth, mask) for camera, mask in zip(cameras, far, strict=True)]
    assert seen_share(views) > 85
    hidden = [replace(view, mask=~view.mask) for view in views]
    assert seen_share([views[0], *hidden[1:]]) == 0


def test_one_blurred_view_of_three_is_enough() -> None:
    cameras = [frontal(WIDTH, 80, 90.0, (x, 0.0, 0.0)) for x in (0.0, 0.1, 0.2)]
    for blurred in range(3):
        lenses = [WIDE if index == blurred else CLOSED for index in range(3)]
        views = [Seen(camera, lens, layered(camera).depth) for camera, lens in zip(cameras, lenses, strict=True)]
        assert seen_share(views) > 50


@given(st.integers(0, 2**31), st.sampled_from([1, 2, 3, 5]))
def test_triples_against_loops(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    rays = np.array([0, 0, 1.0]) + random.normal(0, 0.12, (6, count, 3)) * (random.random((6, count, 1)) < 0.8)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    sees, blurred = random.random((6, count)) < 0.8, random.random((6, count)) < 0.3
    sees[:, 0] = True

    def angle(point: int, one: int, other: int) -> float:
        return math.acos(min(1.0, float(rays[point, one] @ rays[point, other])))

    def counts(point: int, triple: tuple[int, ...]) -> bool:
        angles = [angle(point, *pair) for pair in itertools.combinations(triple, 2)]
        near = max(angles) <= lens_evidence.TOGETHER and max(angles) >= 0.01
        return near and sees[point, list(triple)].all() and blurred[point, list(triple)].any()

    expected = [
        any(counts(point, (0, *pair)) for pair in itertools.combinations(range(1, count), 2)) for point in range(6)
    ]
    assert lens_evidence._three(rays, sees, blurred, 0, 0.01).tolist() == expected


@given(st.integers(-12, 12).map(lambda power: 2.0**power))  # whose products aren't rounded
def test_the_scene_unit_does_not_count(unit: float) -> None:
    def scaled(by: float) -> float:
        cameras = [frontal(WIDTH, 80, 90.0, (x * by, 0.0, 0.0)) for x in NEIGHBOURS]
        lens = PhysicalLens(WIDE.aperture * by, WIDE.focus_disparity / by, WIDTH)
        plain = [layered(frontal(WIDTH, 80, 90.0, (x, 0.0, 0.0))).depth for x in NEIGHBOURS]
        return seen_share([Seen(camera, lens, depth * by) for camera, depth in zip(cameras, plain, strict=True)])

    assert scaled(unit) == scaled(1.0)


def test_shares_by_hand() -> None:
    sharp, scored = np.full((2, 2, 3), 0.5, np.float32), np.array([[True, False], [True, True]])
    lensed, photograph = sharp + np.float32(0.125), sharp + np.float32(0.25)
    found = energies(lensed, sharp, photograph, scored)
    assert found == pytest.approx((9 * 0.125**2, 9 * 0.25**2), rel=FLOAT64_VALUE)
    assert energy_share([found, found]) == pytest.approx(25, rel=FLOAT64_VALUE)
    assert energy_share([(0.0, 0.0)]) == 0
    with pytest.raises(ValueError, match="at least one view"):
        seen_share([])


@pytest.mark.parametrize(("energy", "seen", "able"), [(5, 10, True), (4.9, 90, False), (90, 9.9, False)])
def test_both_are_needed_and_both_are_stated(energy: float, seen: float, able: bool) -> None:
    said = cannot_rank(energy, seen)
    assert (said == "") == able
    assert able or (f"{energy:.1f} % of the error" in said and f"{seen:.1f} % of the pixels" in said)
