"""Recipes: plain data determined by a seed, and the property for which each recipe was made."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import get_args

import numpy as np
import pytest
from tolerances import FLOAT64_VALUE, POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.scenes.procedural.recipes import recipe
from dofbench.scenes.procedural.scene_options import NAMES
from dofbench.scenes.procedural.shapes import box, ground, leaf, merged, rod, turned
from dofbench.scenes.procedural.stage import Finish, Viewpoints, cameras
from dofbench.scenes.procedural.textures import directions

POINTS = Viewpoints((0.0, 0.0, 1.0), (0.5, 4.0, 0.6), (0.3, 0.05, 0.2), aim=0.05, arc=90)


def equal(one, other):
    """The same plain data."""
    if is_dataclass(one) and type(one) is type(other):
        return all(equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(equal(a, b) for a, b in zip(one, other, strict=True))
    return bool(np.array_equal(one, other))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", NAMES)
def test_every_recipe_has_a_title_and_viewpoints(name):
    made = recipe(name)
    assert made.TITLE and made.VIEWPOINTS.target[1] > made.VIEWPOINTS.eye[1]


def test_an_unknown_recipe_is_named():
    with pytest.raises(InputError, match="one of attic, corridor"):
        recipe("beach")


@pytest.mark.parametrize("name", ["corridor", pytest.param("night", marks=pytest.mark.slow)])
def test_the_seed_fixes_a_stage(name):
    made = recipe(name)
    assert equal(made.stage(3), made.stage(3))
    assert not equal(made.stage(3), made.stage(4))


@pytest.mark.slow
def test_the_recipes_have_what_makes_defocus_hard():
    stages = {name: recipe(name).stage(0) for name in NAMES}

    def props(name, finish):
        return [prop for prop in stages[name].props if prop.finish == finish]

    def plain(stage):
        return sum(not isinstance(prop.texture, np.ndarray) for prop in stage.props) / len(stage.props)

    assert len(props("night", "lamp")) > 20 and max(prop.radiance for prop in props("night", "lamp")) > 30
    assert len(props("gloss", "glossy")) > 5 and len(props("gloss", "metal")) > 3
    assert plain(stages["corridor"]) > 0.8 and plain(stages["tiles"]) < 0.3
    assert isinstance(stages["meadow"].sky, np.ndarray)
    assert {prop.finish for stage in stages.values() for prop in stage.props} == set(get_args(Finish))
    for stage in stages.values():
        for prop in stage.props:
            if isinstance(prop.texture, np.ndarray):
                assert 0 <= prop.texture.min() and prop.texture.max() <= 1


@pytest.mark.parametrize("kind", ["forward", "orbit"])
def test_cameras_look_at_the_target_and_a_seed_fixes_them(kind):
    made, again, other = (cameras(POINTS, kind, 9, 64, 48, seed) for seed in (1, 1, 2))  # type: ignore[arg-type]
    for one, two in zip(made, again, strict=True):
        np.testing.assert_array_equal(one.world_to_camera, two.world_to_camera)
    assert not np.array_equal(made[0].world_to_camera, other[0].world_to_camera)
    for camera in made:
        (xy,), (z,) = camera.project(np.array([POINTS.target]))
        assert np.abs(xy - (32, 24)).max() < 2 and z > 3
        rotation = camera.world_to_camera[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=POSE_ROUND_TRIP)
        assert rotation[1, 2] < -0.9  # the picture's down is the world's down


def test_an_orbit_keeps_its_distance_and_spans_its_arc():
    def angle(camera):
        x, y = camera.centre[:2] - POINTS.target[:2]
        return float(np.degrees(np.arctan2(y, x)))

    made = cameras(POINTS, "orbit", 9, 64, 48, 0)
    away = [np.hypot(*(camera.centre[:2] - POINTS.target[:2])) for camera in made]
    np.testing.assert_allclose(away, np.hypot(0.5, 4.0))
    assert angle(made[-1]) - angle(made[0]) == pytest.approx(90 * 8 / 9)


def test_shapes_keep_their_measures():
    parts = [box(0, 0, (1, 2, 3)), rod((0, 0, 0), (0, 0, 2), 0.1), leaf((0, 0, 0), (0.2, 0, 0), (0, 0, 1), 0.1)]
    whole = merged(parts)
    start = 0
    for part in parts:
        chosen = whole.faces[start : start + len(part.faces)]
        np.testing.assert_array_equal(whole.vertices[chosen], part.vertices[part.faces])
        start += len(part.faces)
    assert start == len(whole.faces) and whole.uv.shape == (len(whole.vertices), 2)
    stick = rod((1, 2, 3), (1, 2, 5), 0.25)
    np.testing.assert_allclose(np.hypot(*(stick.vertices[:, :2] - (1, 2)).T), 0.25)
    land = ground(np.linspace(-1, 1, 5), np.linspace(0, 2, 4), lambda x, y: x + 2 * y, 1.0)
    np.testing.assert_allclose(land.vertices[:, 2], land.vertices[:, 0] + 2 * land.vertices[:, 1])
    up = np.cross(*(np.diff(land.vertices[land.faces], axis=1).transpose(1, 0, 2)))
    assert (up[:, 2] > 0).all()
    way = directions(64)
    np.testing.assert_allclose(np.linalg.norm(way, axis=-1), 1, rtol=FLOAT64_VALUE)
    assert way[0, :, 2].min() > 0.99 and way[-1, :, 2].max() < -0.99
    assert way[32, 0, 0] > 0.99 and way[32, 32, 1] > 0.99


def test_a_turned_body_has_its_profile_and_looks_outwards():
    profile = [(0.1, 0.0), (0.3, 0.2), (0.3, 0.5), (0.25, 0.5), (0.0, 0.1)]  # outside upwards, then inside downwards
    body = turned(1.0, 2.0, profile, base=0.5, sides=24)
    np.testing.assert_allclose(np.unique(body.vertices[:, 2].round(9)), [0.5, 0.6, 0.7, 1.0])
    radius = np.hypot(body.vertices[:, 0] - 1, body.vertices[:, 1] - 2).reshape(len(profile), -1)
    np.testing.assert_allclose(radius, np.repeat([[r] for r, _ in profile], 25, axis=1), atol=FLOAT64_VALUE)
    corners = body.vertices[body.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - (1, 2, 0)
    # First one triangle of every square, then the other one: (2, steps of the profile, sides).
    outwards = (normal[:, :2] * away[:, :2]).sum(axis=1).reshape(2, len(profile) - 1, -1)
    assert (outwards[:, :2] > 0).all() and (outwards[:, 3] <= FLOAT64_VALUE).all() and (outwards[:, 3] < 0).any()
    assert (normal.reshape(2, len(profile) - 1, -1, 3)[:, 2, :, 2] > 0).all()  # the rim looks up
