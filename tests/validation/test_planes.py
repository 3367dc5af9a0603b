"""The thin lens before planes: against what is known of it without any sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tolerances import FLOAT32_VALUE

from dofbench.images import encode
from dofbench.validation.planes import SCENES, Plane, photograph
from dofbench.validation.variants import VARIANTS


def psnr(a: np.ndarray, b: np.ndarray, border: int) -> float:
    inside = np.s_[border:-border, border:-border]
    return -10 * math.log10(np.mean((np.clip(a, 0, 1)[inside] - b[inside]) ** 2))


def test_a_closed_lens_takes_the_sharp_picture():
    truth = photograph("two walls", SCENES["two walls"], 0.0, 0.5, points=2)
    assert np.abs(truth.photograph - truth.sharp).max() < FLOAT32_VALUE
    assert truth.aperture == 0


def test_a_plane_in_focus_stays_sharp():
    truth = photograph("one wall", (Plane(1, 2.0, "all", 0.5),), 8.0, 0.5, points=8)
    assert np.abs(truth.photograph - truth.sharp).max() < FLOAT32_VALUE


def test_one_plane_out_of_focus_is_what_the_scatter_makes_of_it():
    """Without anything to hide, scatter and lens are the same convolution; the soft edge of the disc is all between."""
    truth = photograph("one wall", (Plane(1, 2.0, "all", 1.0),), 6.0, 0.0, points=600)
    assert np.allclose(truth.signed_radius, 6.0)
    assert psnr(VARIANTS["scatter"](truth), truth.photograph, truth.border) > 55
    assert psnr(VARIANTS["no blur"](truth), truth.photograph, truth.border) < 30


def test_a_slanted_plane_blurs_by_its_own_radius_everywhere():
    truth = photograph("floor", (Plane(3, 2.0, "all", 0.5, (0.0, 0.5)),), 6.0, 0.5, points=600)
    rows = truth.signed_radius.mean(axis=1)
    assert np.all(np.diff(rows) > 0) and abs(rows[len(rows) // 2]) < 0.1
    assert psnr(VARIANTS["scatter"](truth), truth.photograph, truth.border) > 45


def test_the_truth_says_how_good_it_is():
    coarse, fine = (photograph("bars", SCENES["thin bars"], 8.0, 0.05, points=points) for points in (64, 512))
    assert fine.own_error_db > coarse.own_error_db > 20


def test_a_highlight_is_spread_before_it_is_cut_off():
    truth = photograph("highlights", SCENES["highlights"], 8.0, 0.6, points=64)
    assert truth.sharp.max() > 2 and truth.photograph.max() <= 1
    bright = psnr(VARIANTS["layered, 16"](truth), truth.photograph, truth.border)
    cut = truth.sharp.clip(0, 1)
    assert bright > psnr(cut, truth.photograph, truth.border) + 3


def test_an_unknown_stencil_is_named():
    with pytest.raises(ValueError, match="stencil"):
        photograph("none", (Plane(1, 2.0, "star", 0.5),), 4.0, 0.5, points=2)


def test_encoding_is_the_papers():
    truth = photograph("one wall", (Plane(1, 2.0, "all", 0.5),), 0.0, 0.5, points=2)
    assert np.allclose(encode(truth.sharp**truth.gamma), truth.sharp, atol=FLOAT32_VALUE)
