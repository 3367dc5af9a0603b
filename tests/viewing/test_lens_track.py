"""Keyframes of focus and aperture: passed, eased, and in a camera's units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.viewing.lens_track import Key, LensTrack, Track

CAMERA = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, np.eye(4))
EASINGS = ("smooth", "linear", "in", "out")


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=6), st.sampled_from(EASINGS))
def test_every_keyframe_is_passed_and_nothing_lies_outside_of_its_neighbours(values: list[float], easing: str) -> None:
    track = Track.even(values, easing)
    for index, value in enumerate(values):
        assert track.at(index / max(len(values) - 1, 1)) == pytest.approx(value, abs=10 * FLOAT64_VALUE)
    for moment in np.linspace(-0.2, 1.2, 57):
        place = min(max(moment, 0), 1) * (len(values) - 1)
        near = values[int(np.floor(place))], values[int(np.ceil(place))]
        assert min(near) - 1e-9 <= track.at(moment) <= max(near) + 1e-9


def test_easings_start_and_end_as_they_say() -> None:
    step = 1e-4
    for easing, starts, ends in (("smooth", 0, 0), ("linear", 1, 1), ("in", 0, 2), ("out", 2, 0)):
        track = Track([Key(0, 0.0), Key(1, 1.0, easing)])
        assert track.at(step) / step == pytest.approx(starts, abs=1e-3)
        assert (1 - track.at(1 - step)) / step == pytest.approx(ends, abs=1e-3)
    jump = Track([Key(0, 1.0), Key(0.5, 2.0, "hold"), Key(1, 5.0, "linear")])
    assert jump.at(0.4999) == 1.0 and jump.at(0.5) == 2.0 and jump.at(0.75) == pytest.approx(3.5)


def test_a_point_stays_in_focus_and_blur_grows_with_a_zoom() -> None:
    point = np.array([0.3, 0.2, 4.0])
    track = LensTrack(Track.even([0.05, 0.1]), point)
    for z in (0.0, 1.0, 3.0):
        pose = np.eye(4)
        pose[2, 3] = -z
        lens = track.lens(0.0, replace(CAMERA, world_to_camera=pose))
        assert lens.focus_depth == pytest.approx(4.0 - z) and lens.half_opening(CAMERA) == pytest.approx(0.05)
    behind = np.eye(4)
    behind[2, 3] = -5.0
    assert track.lens(0.0, replace(CAMERA, world_to_camera=behind)).focus_disparity == 0.0
    zoomed = replace(CAMERA, fx=160.0, fy=160.0)
    assert track.lens(1.0, zoomed).aperture == pytest.approx(2 * track.lens(1.0, CAMERA).aperture)
    small = CAMERA.resized(48, 32)
    assert track.lens(1.0, small).signed_radius(1.0, 48) == pytest.approx(
        track.lens(1.0, CAMERA).signed_radius(1.0, 96) / 2
    )


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Track([]), "at least one"),
        (lambda: Track([Key(0.5, 1.0), Key(0.5, 2.0)]), "ascending"),
        (lambda: Key(1.5, 1.0), "0 to 1"),
        (lambda: Key(0.5, float("nan")), "finite"),
        (lambda: Key(0.5, 1.0, "bouncy"), "smooth, linear"),
    ],
)
def test_what_is_no_keyframe_is_named(make, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()
