"""Ranks of predictions by the error of their lens, as benchmarks/photographs/blur.py measures them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks.photographs.blur import Condition, Image, correlations

SIGMAS = (0.5, 0.8, 1.2, 1.7, 2.3, 3.0)


@pytest.fixture(scope="module")
def images() -> list[Image]:
    """Coarse and fine texture, equally blurred everywhere: its radius is 2 sigma."""
    generator, size = np.random.default_rng(0), (100, 140)
    fine, coarse = (gaussian_filter(generator.normal(size=size), sigma, mode="wrap") for sigma in (0.5, 6.0))
    light = 0.5 + 0.04 * fine / fine.std() + 0.08 * coarse / coarse.std()
    return [
        Image(np.repeat(gaussian_filter(light, sigma, mode="wrap")[..., None], 3, axis=2), np.full(size, 2 * sigma))
        for sigma in SIGMAS
    ]


def test_without_other_errors_every_score_ranks(images: list[Image]) -> None:
    for row in correlations(images, Condition()):
        assert min(row) > 0.7


def test_blur_is_ranked_where_displacement_hides_it_from_psnr(images: list[Image]) -> None:
    """Displaced by 2 px a sharp prediction is farther off than a blurred one."""
    psnr, _, blur, bias = np.mean([*correlations(images, Condition(shift=2, gain=1.05))], axis=0)
    assert psnr < 0.3 < 0.8 < min(blur, bias)
