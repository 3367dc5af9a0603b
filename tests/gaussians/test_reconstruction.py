"""The spread of depth that a reconstruction reports."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import frontal
from tolerances import FLOAT32_GRADIENT

from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.scene_fit import OPTIONS, Reconstruction

CAMERA = frontal(16, 12, 12.0)


def reconstruction(depths: list[float], opacities: list[float]) -> Reconstruction:
    """Large round Gaussians on the optical axis, one behind the other."""
    count = len(depths)
    means = torch.zeros(count, 3)
    means[:, 2] = torch.tensor(depths)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1
    gaussians = Gaussians(
        {
            "means": means,
            "log_scales": torch.log(torch.tensor(depths))[:, None].repeat(1, 3) + np.log(0.5),
            "quaternions": quaternions,
            "opacity_logits": torch.logit(torch.tensor(opacities)),
            "sh_dc": torch.zeros(count, 3),
            "sh_rest": torch.zeros(count, 0, 3),
        }
    )
    return Reconstruction(gaussians, OPTIONS.with_overrides({"filter_3d": False}))


def test_one_surface_has_no_spread():
    surface = reconstruction([2.0], [0.9]).surface(CAMERA)
    assert surface.spread[6, 8] < FLOAT32_GRADIENT
    # A deviation of 6 pixels, widened by the 2D filter, half a pixel from the pixel's centre along both axes.
    variance = 36 + OPTIONS.appearance.filter_2d
    expected = 0.9 * 36 / variance * np.exp(-0.5 * (0.5**2 + 0.5**2) / variance)
    assert surface.alpha[6, 8] == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_spread_is_the_deviation_of_what_is_blended():
    """Weights and disparities by hand, at the pixel in the middle."""
    surface = reconstruction([2.0, 4.0], [0.5, 0.8]).surface(CAMERA)
    near, far = (reconstruction([z], [a]).surface(CAMERA).alpha[6, 8] for z, a in ((2.0, 0.5), (4.0, 0.8)))
    weights = np.array([near, (1 - near) * far])
    share = weights / weights.sum()
    disparity = np.array([0.5, 0.25])
    expected = np.sqrt(share @ disparity**2 - (share @ disparity) ** 2)
    assert surface.alpha[6, 8] == pytest.approx(weights.sum(), rel=FLOAT32_GRADIENT)
    assert surface.spread[6, 8] == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_nothing_is_unknown():
    surface = reconstruction([2.0], [0.05]).surface(CAMERA)
    assert (surface.depth == 0).all() and (surface.spread == 0).all()
