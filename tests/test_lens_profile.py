"""Lenses measured by the blur of photographs that show one surface, against lenses that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pictured_tabletop as tabletop
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dofbench.core.contracts import TrainingSet
from dofbench.core.lens import DisparityRange
from dofbench.optics.tone import decode, encode
from dofbench.training.common.blur_pairs import STRIDE, BlurPairs, Surface, blur_pairs
from dofbench.training.common.lens_profile import MeasuredLenses, measure_lenses
from dofbench.training.common.lenses import Ties

FOCI = (0.2, 0.5, 0.8)


def tied(count: int) -> Ties:
    """One aperture, a focus each."""
    return Ties((0,) * count, tuple(range(count)), (1.0,) * count)


def surfaces(taken: TrainingSet) -> list[Surface]:
    return [
        Surface.of(view.camera, view.image, depth, None, 2.2)
        for view, depth in zip(taken.views, tabletop.depths(), strict=True)
    ]


def measured(taken: TrainingSet, ties: Ties | None = None) -> MeasuredLenses | None:
    pairs = blur_pairs(surfaces(taken), tabletop.bounds().extent)
    widths = np.full(len(taken.views), tabletop.WIDTH)
    return measure_lenses(pairs, tabletop.bounds(), ties or tied(len(taken.views)), widths, 0)


@pytest.mark.parametrize("aperture", [1.2, 2.4])
def test_known_lenses_are_found(aperture):
    found = measured(tabletop.photographs([aperture], FOCI))
    assert found is not None and found.determined
    assert found.aperture == pytest.approx(np.full(tabletop.count(), aperture), rel=0.2)
    assert found.low < aperture < found.high * 1.05
    wanted = [FOCI[number % 3] for number in range(tabletop.count())]
    assert np.median(np.abs(found.foci - wanted)) < 0.05


def test_a_pixel_without_depth_in_the_middle_of_a_patch_measures_nothing():
    """As where nothing is rendered: the rest of the patch has depth, but its place has none."""
    taken = surfaces(tabletop.photographs([1.2], FOCI))
    holed = []
    for surface in taken:
        depth = surface.depth.copy()
        depth[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE][::3, ::2] = 0
        holed.append(replace(surface, depth=depth))
    extent = 1e3 * tabletop.bounds().extent  # however uneven the depth
    whole, pairs = blur_pairs(taken, extent), blur_pairs(holed, extent)
    assert 0 < len(pairs) < len(whole)
    assert np.isfinite([pairs.q_first, pairs.q_second, pairs.zoom, pairs.difference, pairs.deviation]).all()


def test_sharp_photographs_determine_no_aperture():
    found = measured(tabletop.photographs([0.0], FOCI))
    assert found is None or not found.determined


def test_exposure_of_a_photograph_changes_little():
    taken = tabletop.photographs([2.0], FOCI)
    gains = np.random.default_rng(0).uniform(0.7, 1.0, len(taken.views))
    darker = [
        replace(view, image=encode(gain * decode(view.image)).astype(np.float32))
        for view, gain in zip(taken.views, gains, strict=True)
    ]
    before, after = measured(taken), measured(replace(taken, views=tuple(darker)))
    assert before is not None and after is not None
    assert after.aperture == pytest.approx(before.aperture, rel=0.03)


def test_too_few_patches_measure_nothing():
    pairs = BlurPairs(*(np.zeros(3, int) for _ in range(2)), *(np.ones(3) for _ in range(5)))
    assert measure_lenses(pairs, DisparityRange(0.1, 1.0), tied(2), np.full(2, 100), 0) is None


def made_up(aperture: np.ndarray, foci: np.ndarray, noise: float, seed: int) -> BlurPairs:
    """Patches of every two views, in the range 0 to 1, for images 200 px wide: a radius of 4 px at aperture 1."""
    random, views = np.random.default_rng(seed), len(aperture)
    first, second = (grid.ravel() for grid in np.mgrid[:views, :views])
    first, second = (np.repeat(one[first != second], 12) for one in (first, second))
    q_first = random.uniform(0, 1, len(first))
    q_second = np.clip(q_first + random.normal(0, 0.02, len(first)), 0, 1)
    zoom = random.uniform(0.9, 1.1, len(first))
    mine = (2 * aperture[first] * (q_first - foci[first])) ** 2
    theirs = (2 * zoom * aperture[second] * (q_second - foci[second])) ** 2
    deviation = np.full(len(first), 0.1)
    return BlurPairs(
        first, second, q_first, q_second, zoom, mine - theirs + noise * random.normal(0, 0.1, len(first)), deviation
    )


@given(st.integers(0, 1000), st.floats(0.6, 2.5))
@settings(max_examples=8, deadline=None)
def test_made_up_patches_of_one_aperture(seed, aperture):
    random = np.random.default_rng(seed)
    foci = np.concatenate([[0.1, 0.9], random.uniform(0, 1, 6)])
    pairs = made_up(np.full(8, aperture), foci, 1.0, seed)
    found = measure_lenses(pairs, DisparityRange(0.0, 1.0), Ties.untied(8), np.full(8, 200), 0)
    assert found is not None and found.determined and not found.each
    assert found.aperture == pytest.approx(np.full(8, aperture), rel=0.15)
    assert found.foci == pytest.approx(foci, abs=0.15)


def test_apertures_that_differ_are_told_apart():
    aperture, foci = np.array([1.0, 0.5] * 5), np.linspace(0.05, 0.95, 10)[np.random.default_rng(1).permutation(10)]
    pairs = made_up(aperture, foci, 1.0, 0)
    found = measure_lenses(pairs, DisparityRange(0.0, 1.0), Ties.untied(10), np.full(10, 200), 0)
    assert found is not None and found.each
    assert np.median(np.abs(found.aperture / aperture - 1)) < 0.1


def test_openings_of_exif_are_part_of_the_aperture():
    opening = np.array([1.0, 2.0] * 4)
    foci = np.linspace(0.1, 0.9, 8)
    pairs = made_up(0.7 * opening, foci, 1.0, 0)
    ties = Ties((0,) * 8, tuple(range(8)), tuple(opening))
    found = measure_lenses(pairs, DisparityRange(0.0, 1.0), ties, np.full(8, 200), 0)
    assert found is not None and found.determined
    assert found.aperture == pytest.approx(0.7 * opening, rel=0.15)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_one_plane_leaves_the_aperture_open(noise):
    """At one disparity, a wide lens focused near it blurs like a narrow one focused far from it."""
    foci = np.linspace(0.1, 0.9, 8)
    pairs = made_up(np.full(8, 1.0), foci, 1.0, 0)
    mine = (2 * (0.5 - foci[pairs.first])) ** 2
    theirs = (2 * pairs.zoom * (0.5 - foci[pairs.second])) ** 2
    flat, error = np.full(len(pairs), 0.5), np.random.default_rng(2).normal(size=len(pairs))
    plane = replace(pairs, q_first=flat, q_second=flat, difference=mine - theirs + noise * error)
    found = measure_lenses(plane, DisparityRange(0.0, 1.0), tied(8), np.full(8, 200), 0)
    assert found is None or not found.determined
