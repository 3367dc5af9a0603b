"""Learned lenses: each view finds its own, what views share, and lenses that start from EXIF."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from small_scene import training_set
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE, LENS_FLOOR, LENS_FOUND

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import DisparityRange, Lens
from dofbench.training.common.lenses import LearnedLenses, LensOptions, first_lenses, foci_by_exif, lens_ties

RANGE = DisparityRange(0.02, 0.06)


def _train(lenses, target, steps, order):
    for step in range(steps):
        index = order[step % len(order)]
        slope, offset = lenses.forward(index)
        ((slope - target[0]) ** 2 + (offset + target[0] * target[1]) ** 2).backward()
        lenses.step(index, step / steps)


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("update", ["view", "dense"])
def test_each_view_finds_its_lens(activation, update):
    options = LensOptions(lens_activation=activation, lens_update=update, lens_lr=2e-2, lens_lr_final=1e-4)
    lenses = LearnedLenses(2, RANGE, options)
    _train(lenses, (0.9, 0.2), 2000, [0, 1])
    for index in range(2):
        found = Lens.from_physical(lenses.estimate(index, 504), RANGE)
        assert abs(found.aperture - 0.9) < LENS_FOUND and abs(found.focus - 0.2) < LENS_FOUND


def test_dense_update_is_adam_over_the_whole_vector():
    options = LensOptions(lens_update="dense", lens_lr=1e-2, lens_lr_final=1e-2)
    lenses = LearnedLenses(3, RANGE, options)
    vector = torch.full((3, 2), 0.5, requires_grad=True)
    adam = torch.optim.Adam([vector], lr=1e-2, eps=1e-15)
    for step in range(30):
        index = step % 3
        slope, offset = lenses.forward(index)
        ((slope - 1) ** 2 + (offset + 0.1) ** 4).backward()
        lenses.step(index, 0.0)
        adam.zero_grad()
        row = torch.relu(vector[index]) + 1e-5
        ((row[0] - 1) ** 2 + (0.1 - row[0] * row[1]) ** 4).backward()
        adam.step()
    assert np.allclose(lenses.state()["raw"], vector.detach().numpy(), atol=FLOAT32_VALUE)


def test_the_estimate_does_not_depend_on_the_methods_own_range():
    """The same physical lens comes out whichever disparity range the method trained in."""
    truth = Lens(0.7, 0.3).physical(RANGE, 504)
    for own in (RANGE, DisparityRange(0.01, 0.09)):
        inside = Lens.from_physical(truth, own)
        lenses = LearnedLenses(
            1,
            own,
            LensOptions(lens_activation="log", lens_init_aperture=inside.aperture, lens_init_focus=inside.focus),
        )
        found = Lens.from_physical(lenses.estimate(0, 504), RANGE)
        assert found.aperture == pytest.approx(0.7, abs=FLOAT32_VALUE)
        assert found.focus == pytest.approx(0.3, abs=FLOAT32_VALUE)


def test_a_closed_lens_keeps_the_least_aperture():
    """The released code adds 1e-5 behind the relu: A is never less, and F never below it."""
    lenses = LearnedLenses(1, RANGE, LensOptions(lens_activation="relu"))
    lenses.spoil(-0.3)
    slope, offset = lenses.forward(0)
    assert float(slope.detach()) == pytest.approx(1e-5, rel=FLOAT32_VALUE)
    assert float(offset.detach()) == pytest.approx(-1e-10, rel=FLOAT32_VALUE)
    lenses.spoil(0.3)
    slope, offset = lenses.forward(0)
    assert float(slope.detach()) == pytest.approx(0.30001, rel=FLOAT32_VALUE / 10)
    assert float(offset.detach()) == pytest.approx(-(0.30001**2), rel=FLOAT32_VALUE / 10)


WIDE = DisparityRange(0.1, 0.6)


def _focused_at(*distances: float | None):
    views = training_set().views
    return [
        dataclasses.replace(view, exif=None if distance is None else Exif(f_number=4.0, focus_distance=distance))
        for view, distance in zip(views, distances, strict=True)
    ]


def _disparities(foci: list[float]) -> np.ndarray:
    return WIDE.q_min + WIDE.extent * np.array(foci)


def test_disparities_in_focus_have_exif_s_ratios_and_the_median_is_where_all_would_start() -> None:
    disparities = _disparities(foci_by_exif(_focused_at(2.0, 1.0, 1.6), WIDE, 0.4))
    np.testing.assert_allclose(disparities / disparities[2], [0.8, 1.6, 1.0], rtol=FLOAT64_VALUE)
    assert disparities[2] == pytest.approx(0.1 + 0.4 * 0.5, rel=FLOAT64_VALUE)


def test_infinity_is_far_the_unknown_in_the_middle_and_nothing_leaves_the_range() -> None:
    assert foci_by_exif(_focused_at(math.inf, 1.0, None), WIDE, 0.4) == pytest.approx([0.02, 0.4, 0.4])
    far, middle, near = foci_by_exif(_focused_at(100.0, 1.0, 0.01), WIDE, 0.5)
    assert 0 < far < middle < near < 1


@pytest.mark.parametrize("distances", [(None, None, None), (math.inf, None, math.inf)])
def test_without_a_finite_distance_the_option_is_refused(distances: tuple[float | None, ...]) -> None:
    with pytest.raises(InputError, match="lens_focus_from"):
        first_lenses(_focused_at(*distances), WIDE, LensOptions(lens_focus_from="exif"))


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("per", ["view", "aperture", "exif", "scene"])
def test_training_starts_there(activation: str, per: str) -> None:
    views = _focused_at(2.0, 1.0, 1.6)
    options = LensOptions(lens_activation=activation, lens_per=per, lens_init_aperture=0.7, lens_focus_from="exif")
    lenses = first_lenses(views, WIDE, options)
    found = np.array([lenses.aperture_and_focus(index) for index in range(3)])
    expected = np.array(foci_by_exif(views, WIDE, 0.5))
    if per == "scene":
        expected[:] = np.median(expected)
    np.testing.assert_allclose(found[:, 0], 0.7, rtol=LENS_FLOOR)
    np.testing.assert_allclose(found[:, 1], expected, rtol=LENS_FLOOR)


def test_without_the_option_exif_changes_nothing() -> None:
    with_exif, without = (
        first_lenses(views, WIDE, LensOptions())
        for views in (_focused_at(2.0, 1.0, 1.6), _focused_at(None, None, None))
    )
    assert all(with_exif.aperture_and_focus(index) == without.aperture_and_focus(index) for index in range(3))


def _with_f_numbers(*numbers, focal_length=None):
    views = training_set().views
    return [
        dataclasses.replace(view, exif=Exif(f_number=number, focal_length=focal_length))
        for view, number in zip(views, numbers, strict=True)
    ]


def test_openings_are_in_proportion_to_one_over_the_f_number():
    ties = lens_ties(_with_f_numbers(2.8, 5.6, 14.0), "exif")
    assert ties.aperture == (0, 0, 0) and ties.focus == (0, 1, 2)
    np.testing.assert_allclose(np.array(ties.opening) * [2.8, 5.6, 14.0], 5.6, rtol=FLOAT32_VALUE)


def test_a_longer_lens_of_the_same_f_number_is_wider():
    views = _with_f_numbers(4.0, 4.0, 4.0, focal_length=50.0)
    views[2] = dataclasses.replace(views[2], exif=Exif(f_number=4.0, focal_length=100.0))
    opening = lens_ties(views, "exif").opening
    assert opening[2] / opening[0] == pytest.approx(2.0)


def test_circles_grow_with_the_focal_length_in_pixels():
    views = _with_f_numbers(4.0, 4.0, 4.0)
    camera = dataclasses.replace(views[1].camera, fx=2 * views[1].camera.fx, fy=2 * views[1].camera.fy)
    views[1] = dataclasses.replace(views[1], camera=camera)
    assert lens_ties(views, "aperture").opening == pytest.approx((1.0, 2.0, 1.0))


def test_groups_are_by_f_number():
    ties = lens_ties(_with_f_numbers(6.3, 14.0, 6.3), "group")
    assert ties.aperture == (0, 1, 0) and ties.focus == (0, 1, 2)


@pytest.mark.parametrize("per", ["group", "exif"])
def test_photographs_without_f_number_are_named(per):
    views = training_set().views
    with pytest.raises(InputError, match="v0 without an f-number"):
        lens_ties(views, per)


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("update", ["view", "dense"])
def test_views_find_one_aperture_and_a_focus_each(activation, update):
    ties = lens_ties(_with_f_numbers(2.8, 5.6, 14.0), "exif")
    options = LensOptions(
        lens_activation=activation, lens_update=update, lens_lr=2e-2, lens_lr_final=1e-4, lens_per="exif"
    )
    lenses = LearnedLenses(3, RANGE, options, ties)
    truth = [(0.4 * opening, focus) for opening, focus in zip(ties.opening, (0.2, 0.5, 0.8), strict=True)]
    for step in range(3000):
        aperture, focus = truth[step % 3]
        slope, offset = lenses.forward(step % 3)
        ((slope - aperture) ** 2 + (offset + aperture * focus) ** 2).backward()
        lenses.step(step % 3, step / 3000)
    for index, (aperture, focus) in enumerate(truth):
        found = Lens.from_physical(lenses.estimate(index, 504), RANGE)
        assert abs(found.aperture - aperture) < LENS_FOUND and abs(found.focus - focus) < LENS_FOUND


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
def test_what_is_shared_from_now_on_is_the_median_of_what_was_found(activation):
    options = LensOptions(lens_activation=activation)
    lenses = LearnedLenses(3, RANGE, options)
    start = [lenses.aperture_and_focus(view) for view in range(3)]
    for view, (aperture, focus) in enumerate([(0.3, 0.2), (0.5, 0.5), (0.6, 0.9)]):
        first, second = lenses._raw_of(aperture, focus)
        lenses._tables[0].values[view], lenses._tables[1].values[view] = first, second
    shared = lenses.shared(lens_ties(training_set().views, "aperture"))
    np.testing.assert_allclose(
        [shared.aperture_and_focus(view) for view in range(3)], [(0.5, 0.2), (0.5, 0.5), (0.5, 0.9)], rtol=LENS_FLOOR
    )
    scene = lenses.shared(lens_ties(training_set().views, "scene"))
    np.testing.assert_allclose([scene.aperture_and_focus(view) for view in range(3)], [(0.5, 0.5)] * 3, rtol=LENS_FLOOR)
    assert start == [pytest.approx((0.5, 0.5), rel=LENS_FLOOR)] * 3


def _upright(view):
    """The same view, the camera turned by a quarter."""
    camera = view.camera
    turned = Camera(camera.height, camera.width, camera.fy, camera.fx, camera.cy, camera.cx, camera.world_to_camera)
    return dataclasses.replace(view, camera=turned)


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("per", ["scene", "aperture", "exif"])
def test_one_lens_has_one_opening_upright_and_across(per, activation):
    views = _with_f_numbers(4.0, 4.0, 4.0)
    views[1] = _upright(views[1])
    views[2] = dataclasses.replace(views[2], camera=dataclasses.replace(views[2].camera, fx=77.0))
    options = LensOptions(lens_activation=activation, lens_per=per)
    ties = lens_ties(views, per)
    separate = LearnedLenses(3, RANGE, options)
    for lenses in (LearnedLenses(3, RANGE, options, ties), separate.shared(ties)):
        found = [lenses.estimate(index, view.camera.width) for index, view in enumerate(views)]
        openings = [lens.half_opening(view.camera) for lens, view in zip(found, views, strict=True)]
        np.testing.assert_allclose(openings, openings[0], rtol=LENS_FLOOR)
        if per == "scene":
            np.testing.assert_allclose(
                [lens.focus_disparity for lens in found], found[0].focus_disparity, rtol=LENS_FLOOR
            )
        for index in range(3):  # what is learned is what is estimated
            aperture, focus = lenses.aperture_and_focus(index)
            slope, offset = (value.item() for value in lenses.forward(index))
            assert (slope, -slope * focus) == pytest.approx((aperture, offset), rel=LENS_FLOOR)


def test_circles_are_learned_as_shares_of_the_width():
    """A photograph of twice the size by the same lens: twice the pixels of focal length, and of width."""
    views = _with_f_numbers(4.0, 4.0, 4.0)
    views[1] = dataclasses.replace(views[1], camera=views[1].camera.resized(96, 72))
    assert lens_ties(views, "aperture").opening == pytest.approx((1.0, 1.0, 1.0))
