"""What photographs share of a lens, against the formula of a thin lens."""

import dataclasses

import numpy as np
import pytest
from small_scene import training_set
from tolerances import FLOAT32_VALUE, LENS_FLOOR, LENS_FOUND

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import DisparityRange, Lens
from dofbench.training.common.lenses import LearnedLenses, LensOptions, lens_ties

RANGE = DisparityRange(0.02, 0.06)


def _views(*numbers, focal_length=None):
    views = training_set().views
    return [
        dataclasses.replace(view, exif=Exif(f_number=number, focal_length=focal_length))
        for view, number in zip(views, numbers, strict=True)
    ]


def test_openings_are_in_proportion_to_one_over_the_f_number():
    ties = lens_ties(_views(2.8, 5.6, 14.0), "exif")
    assert ties.aperture == (0, 0, 0) and ties.focus == (0, 1, 2)
    np.testing.assert_allclose(np.array(ties.opening) * [2.8, 5.6, 14.0], 5.6, rtol=FLOAT32_VALUE)


def test_a_longer_lens_of_the_same_f_number_is_wider():
    views = _views(4.0, 4.0, 4.0, focal_length=50.0)
    views[2] = dataclasses.replace(views[2], exif=Exif(f_number=4.0, focal_length=100.0))
    opening = lens_ties(views, "exif").opening
    assert opening[2] / opening[0] == pytest.approx(2.0)


def test_circles_grow_with_the_focal_length_in_pixels():
    views = _views(4.0, 4.0, 4.0)
    camera = dataclasses.replace(views[1].camera, fx=2 * views[1].camera.fx, fy=2 * views[1].camera.fy)
    views[1] = dataclasses.replace(views[1], camera=camera)
    assert lens_ties(views, "aperture").opening == pytest.approx((1.0, 2.0, 1.0))


def test_groups_are_by_f_number():
    ties = lens_ties(_views(6.3, 14.0, 6.3), "group")
    assert ties.aperture == (0, 1, 0) and ties.focus == (0, 1, 2)


@pytest.mark.parametrize("per", ["group", "exif"])
def test_photographs_without_f_number_are_named(per):
    views = training_set().views
    with pytest.raises(InputError, match="v0 without an f-number"):
        lens_ties(views, per)


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("update", ["view", "dense"])
def test_views_find_one_aperture_and_a_focus_each(activation, update):
    ties = lens_ties(_views(2.8, 5.6, 14.0), "exif")
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
    views = _views(4.0, 4.0, 4.0)
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
    views = _views(4.0, 4.0, 4.0)
    views[1] = dataclasses.replace(views[1], camera=views[1].camera.resized(96, 72))
    assert lens_ties(views, "aperture").opening == pytest.approx((1.0, 1.0, 1.0))
