"""A blur of its own for each photograph, added to every footprint, as in RGS."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    no_view,
    one_gaussian,
    shot,
)
from tolerances import ADAM_TURNS, BLUR_INTEGRAL, FLOAT32_GRADIENT

from dofbench.methods.rgs.method import UniformBlur, UniformBlurOptions


def test_a_uniform_blur_adds_its_variance_to_every_footprint_and_keeps_its_light() -> None:
    """A Gaussian of 1.5 px through a blur of 2 px is one of 2.5 px."""
    own, through = 1.5, 2.0
    blur = UniformBlur(2, UniformBlurOptions(view_blur_init=1e3 * through / CAMERA.width))
    image = blur.render(one_gaussian(own), no_view(), shot(1))
    sharp = one_gaussian(own).rasterise(CAMERA, "none").color
    rows, columns = np.mgrid[:36, :48] + 0.5
    square = (columns - CAMERA.cx) ** 2 + (rows - CAMERA.cy) ** 2
    colour = 0.5 + 0.5 / math.sqrt(math.pi)
    expected = 0.5 * colour * own**2 / 6.25 * np.exp(-square / (2 * 6.25))
    near = square < 16
    np.testing.assert_allclose(image.detach().numpy()[near][:, 0], expected[near], rtol=FLOAT32_GRADIENT)
    assert float(image.detach().sum()) == pytest.approx(float(sharp.detach().sum()), rel=BLUR_INTEGRAL)


def test_a_uniform_blur_is_found_for_each_photograph_by_itself() -> None:
    """The scene is known; photograph 0 was blurred by 0.5 px, photograph 1 by 2 px."""
    scene, true = one_gaussian(1.5), (0.5, 2.0)
    targets = [
        UniformBlur(1, UniformBlurOptions(view_blur_init=1e3 * one / CAMERA.width)).render(scene, no_view(), shot(0))
        for one in true
    ]
    blur = UniformBlur(2, UniformBlurOptions(view_blur_init=20.0, view_blur_lr=0.5))
    for step in range(300):
        view = step % 2
        found = blur.render(scene, no_view(), shot(view))
        (found - targets[view].detach()).square().sum().backward()
        assert blur.gradient() is not None
        blur.step(view, step / 300, 1.0 if step < 200 else 0.1)
    pixels = blur.deviations() * CAMERA.width * 1e-3
    step = 0.5 * 0.1 * CAMERA.width * 1e-3  # px, the last ones
    assert (pixels.abs() - torch.tensor(true)).abs().max() / step < ADAM_TURNS
