"""Lenses that start from EXIF's focus distances."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from small_scene import training_set
from tolerances import FLOAT64_VALUE, LENS_FLOOR

from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import DisparityRange
from dofbench.training.common.lenses import LensOptions, first_lenses, foci_by_exif

RANGE = DisparityRange(0.1, 0.6)


def _views(*distances: float | None):
    views = training_set().views
    return [
        dataclasses.replace(view, exif=None if distance is None else Exif(f_number=4.0, focus_distance=distance))
        for view, distance in zip(views, distances, strict=True)
    ]


def _disparities(foci: list[float]) -> np.ndarray:
    return RANGE.q_min + RANGE.extent * np.array(foci)


def test_disparities_in_focus_have_exif_s_ratios_and_the_median_is_where_all_would_start() -> None:
    disparities = _disparities(foci_by_exif(_views(2.0, 1.0, 1.6), RANGE, 0.4))
    np.testing.assert_allclose(disparities / disparities[2], [0.8, 1.6, 1.0], rtol=FLOAT64_VALUE)
    assert disparities[2] == pytest.approx(0.1 + 0.4 * 0.5, rel=FLOAT64_VALUE)


def test_infinity_is_far_the_unknown_in_the_middle_and_nothing_leaves_the_range() -> None:
    assert foci_by_exif(_views(math.inf, 1.0, None), RANGE, 0.4) == pytest.approx([0.02, 0.4, 0.4])
    far, middle, near = foci_by_exif(_views(100.0, 1.0, 0.01), RANGE, 0.5)
    assert 0 < far < middle < near < 1


@pytest.mark.parametrize("distances", [(None, None, None), (math.inf, None, math.inf)])
def test_without_a_finite_distance_the_option_is_refused(distances: tuple[float | None, ...]) -> None:
    with pytest.raises(InputError, match="lens_focus_from"):
        first_lenses(_views(*distances), RANGE, LensOptions(lens_focus_from="exif"))


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("per", ["view", "aperture", "exif", "scene"])
def test_training_starts_there(activation: str, per: str) -> None:
    views = _views(2.0, 1.0, 1.6)
    options = LensOptions(lens_activation=activation, lens_per=per, lens_init_aperture=0.7, lens_focus_from="exif")
    lenses = first_lenses(views, RANGE, options)
    found = np.array([lenses.aperture_and_focus(index) for index in range(3)])
    expected = np.array(foci_by_exif(views, RANGE, 0.5))
    if per == "scene":
        expected[:] = np.median(expected)
    np.testing.assert_allclose(found[:, 0], 0.7, rtol=LENS_FLOOR)
    np.testing.assert_allclose(found[:, 1], expected, rtol=LENS_FLOOR)


def test_without_the_option_exif_changes_nothing() -> None:
    with_exif, without = (
        first_lenses(views, RANGE, LensOptions()) for views in (_views(2.0, 1.0, 1.6), _views(None, None, None))
    )
    assert all(with_exif.aperture_and_focus(index) == without.aperture_and_focus(index) for index in range(3))
