"""The thin lens before planes: compared with exact properties, and with an independent way of sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from tolerances import FLOAT32_VALUE, LENS_COVERED, POLYGON_AREA

from dofbench.core.lens import ApertureShape
from dofbench.evaluation.renderer import planes
from dofbench.evaluation.renderer.lens_points import lens_points, polygon_to_disc
from dofbench.evaluation.renderer.planes import HEIGHT, SCENES, WIDTH, Plane, photograph, seen
from dofbench.evaluation.renderer.variants import VARIANTS
from dofbench.optics.tone import encode

RENDER = {variant.name: variant.render for variant in VARIANTS}


@pytest.fixture(autouse=True)
def _few_points(monkeypatch):
    monkeypatch.setattr(planes, "POINTS", (128, 2048))


def psnr(a: np.ndarray, b: np.ndarray, border: int) -> float:
    inside = np.s_[border:-border, border:-border]
    return -10 * math.log10(np.mean((np.clip(a, 0, 1)[inside] - b[inside]) ** 2))


def test_a_closed_lens_takes_the_sharp_picture():
    truth = photograph(SCENES["two walls"], 0.0, 0.5)
    assert np.abs(truth.photograph - truth.sharp).max() < FLOAT32_VALUE
    assert np.abs(truth.signed_radius).max() == 0 and truth.own_error_db > 90


def test_a_plane_in_focus_stays_sharp():
    truth = photograph((Plane(1, 2.0, "all", 0.5),), 8.0, 0.5)
    assert np.abs(truth.photograph - truth.sharp).max() < FLOAT32_VALUE


def test_one_plane_out_of_focus_is_what_the_scatter_makes_of_it():
    """Without anything to hide, scatter and lens are the same convolution; the soft edge of the disc is all between."""
    truth = photograph((Plane(1, 2.0, "all", 1.0),), 6.0, 0.0)
    assert np.allclose(truth.signed_radius, 6.0)
    assert psnr(RENDER["scatter"](truth), truth.photograph, truth.border) > 55
    assert psnr(RENDER["no blur"](truth), truth.photograph, truth.border) < 30


@pytest.mark.slow
def test_a_hexagonal_lens_is_what_the_hexagonal_scatter_makes_of_it():
    truth = photograph((Plane(8, 3.0, "all", 1.0, highlights=0.0005),), 8.0, 0.0, ApertureShape(6))
    hexagon, disc = (
        psnr(RENDER[name](truth), truth.photograph, truth.border)
        for name in ("scatter", "scatter, other aperture of the same area")
    )
    assert hexagon > 40 and hexagon > disc + 6


def test_a_slanted_plane_blurs_by_its_own_radius_everywhere():
    truth = photograph((Plane(3, 2.0, "all", 0.5, (0.0, 0.5)),), 6.0, 0.5)
    rows = truth.signed_radius.mean(axis=1)
    assert np.all(np.diff(rows) > 0) and abs(rows[len(rows) // 2]) < 0.1
    assert psnr(RENDER["scatter"](truth), truth.photograph, truth.border) > 45


@pytest.mark.parametrize("name", ["slanted floor", "highlights"])
def test_a_view_agrees_with_one_put_together_by_another_library(name):
    """Every plane's picture looked up by SciPy, discs and floor cut out by their definition, laid over each other."""
    scene, radius, focus, (ux, uy) = SCENES[name], 9.0, 0.4, (0.31, -0.77)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    expected = np.zeros((HEIGHT, WIDTH, 3))
    for plane in scene:
        by = radius * plane.slope[1] / (WIDTH / 2)
        # s at the point of the plane that is seen: x = p + s(p) u, solved by iteration.
        s = np.zeros((HEIGHT, WIDTH))
        for _ in range(60):
            px, py = x - s * ux, y - s * uy
            s = radius * (plane.disparity - focus) + by * (py - HEIGHT / 2)
        cover = {
            "all": np.full(s.shape, 1.0),
            "lower half": py - 0.45 * HEIGHT + 0.5,
            "discs": 0.5
            + np.max(
                [
                    r - np.hypot(px - cx * WIDTH, py - cy * HEIGHT)
                    for cx, cy, r in ((0.28, 0.35, 42), (0.72, 0.55, 60), (0.45, 0.85, 30))
                ],
                axis=0,
            ),
        }[plane.stencil].clip(0, 1)[..., None]
        picture = planes._picture(plane).astype(np.float64)
        colour = np.stack([map_coordinates(picture[..., i], (py, px), order=1, mode="grid-wrap") for i in range(3)], -1)
        expected = cover * colour + (1 - cover) * expected
    found = seen(scene, radius, focus, np.array([(ux, uy)]))[0].sum(axis=0)
    assert np.abs(found - expected).max() < FLOAT32_VALUE * max(1.0, expected.max())


@pytest.mark.slow
def test_points_are_added_until_the_truth_is_good_enough():
    scene = SCENES["highlights"]
    coarse, fine = photograph(scene, 12.0, 0.9, own_error_db=0), photograph(scene, 12.0, 0.9, own_error_db=35)
    assert 15 < coarse.own_error_db < 35 <= fine.own_error_db
    # Compared with a finer photograph, the error isn't larger than stated. Both halves are evenly distributed, so
    # together they are better.
    error = -10 * math.log10(np.mean((coarse.photograph - fine.photograph) ** 2))
    assert error > coarse.own_error_db - 2


@pytest.mark.slow
def test_a_highlight_is_spread_before_it_is_cut_off():
    truth = photograph(SCENES["highlights"], 8.0, 0.6)
    assert truth.sharp.max() > 2 and truth.photograph.max() <= 1
    bright, cut = (
        psnr(RENDER[name](truth), truth.photograph, truth.border)
        for name in ("layered, 16", "layered, 16, 8-bit input")
    )
    assert bright > cut + 6


def test_more_samples_of_the_lens_come_closer():
    truth = photograph(SCENES["two walls"], 8.0, 0.5)
    found = [psnr(truth.thin_lens(samples), truth.photograph, truth.border) for samples in (4, 32, 256)]
    assert found[0] + 6 < found[1] < found[2] - 6


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 300), st.integers(0, 300), st.sampled_from([0, 3, 6, 7]))
def test_lens_points_are_one_even_sequence(a, b, blades):
    shape = ApertureShape(blades, rotation=0.3)
    whole = lens_points(a + b, shape)
    assert np.array_equal(whole, np.concatenate([lens_points(a, shape), lens_points(b, shape, first=a)]))
    assert np.all(np.hypot(*whole.T) <= 1)


def test_lens_points_cover_a_lens_evenly():
    points = lens_points(20000)
    radius = np.hypot(*points.T)
    # Shares of area within r go with r squared; quadrants are alike.
    for r in (0.25, 0.5, 0.9):
        assert np.mean(radius <= r) == pytest.approx(r * r, abs=LENS_COVERED)
    assert np.mean((points > 0).all(axis=1)) == pytest.approx(0.25, abs=LENS_COVERED)


def test_a_hexagons_area_is_the_known_one():
    assert polygon_to_disc(ApertureShape(6)) == pytest.approx(math.sqrt(1.5 * math.sqrt(3) / math.pi), rel=POLYGON_AREA)
    assert polygon_to_disc(ApertureShape()) == pytest.approx(1)


def test_an_unknown_stencil_is_named():
    with pytest.raises(ValueError, match="stencil"):
        Plane(1, 2.0, "star", 0.5)


def test_encoding_is_the_papers():
    truth = photograph((Plane(1, 2.0, "all", 0.5),), 0.0, 0.5)
    assert np.allclose(encode(truth.sharp**truth.blur.gamma), truth.sharp, atol=FLOAT32_VALUE)
