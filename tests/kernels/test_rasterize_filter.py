"""Mip-Splatting's 2D filter of a Gaussian much smaller than a pixel, by the closed form of its opacity."""

from __future__ import annotations

import math

import pytest
import torch
from made_up import frontal
from random_gaussians import cpu, reference
from tolerances import FLOAT32_GRADIENT, FLOAT64_VALUE


@pytest.mark.parametrize(("kernel", "dtype"), [(reference, torch.float64), (cpu, torch.float32)])
@pytest.mark.parametrize("sigma", [0.034, 0.05, 0.2, 1.0])
@pytest.mark.parametrize("filter_2d", [0.0, 0.001, 0.1])
def test_opacity_falls_with_the_share_of_the_filtered_footprint(kernel, dtype, sigma, filter_2d) -> None:
    """The released code takes the root of det / (det' + 1e-6) + 1e-6, where det and det' are the footprint's
    determinants, px^4, without and with the filter. A round Gaussian on the axis, in the middle of a pixel."""
    camera = frontal(21, 21, 100.0)
    kind = {"dtype": dtype}
    raster = kernel(
        means=torch.tensor([[0.0, 0.0, 4.0]], **kind),
        log_scales=torch.full((1, 3), math.log(4.0 * sigma / 100.0), **kind),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]], **kind),
        opacity_logits=torch.tensor([math.log(0.9 / 0.1)], **kind),
        sh_dc=torch.zeros(1, 3, **kind),
        sh_rest=torch.zeros(1, 0, 3, **kind),
        camera=camera,
        filter_2d=filter_2d,
    )
    share = 1.0
    if filter_2d:
        share = math.sqrt(sigma**4 / ((sigma**2 + filter_2d) ** 2 + 1e-6) + 1e-6)
    found = float(raster.alpha[10, 10])
    tolerance = FLOAT64_VALUE if dtype == torch.float64 else FLOAT32_GRADIENT
    assert found == pytest.approx(0.9 * share if 0.9 * share > 1 / 255 else 0.0, rel=tolerance)
