"""Mip-Splatting's 2D filter of a Gaussian much smaller than a pixel, by the closed form of its opacity."""

from __future__ import annotations

import math

import pytest
import torch
from made_up import frontal
from random_gaussians import assert_agree, cpu, reference, scene, view
from tolerances import FLOAT32_GRADIENT, FLOAT64_VALUE


@pytest.mark.parametrize(("kernel", "dtype"), [(reference, torch.float64), (cpu, torch.float32)])
@pytest.mark.parametrize("sigma", [0.034, 0.05, 0.2, 1.0])
@pytest.mark.parametrize("filter_2d", [0.0, 0.001, 0.1])
@pytest.mark.parametrize("fades", [True, False])
def test_opacity_falls_with_the_share_of_the_filtered_footprint(kernel, dtype, sigma, filter_2d, fades) -> None:
    """Mip-Splatting's code takes the root of det / (det' + 1e-6) + 1e-6, where det and det' are the footprint's
    determinants, px^4, without and with the filter. A round Gaussian on the axis, in the middle of a pixel. 3DGS's
    dilation keeps the opacity."""
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
        filter_2d_fades=fades,
    )
    share = 1.0
    if filter_2d and fades:
        share = math.sqrt(sigma**4 / ((sigma**2 + filter_2d) ** 2 + 1e-6) + 1e-6)
    found = float(raster.alpha[10, 10])
    tolerance = FLOAT64_VALUE if dtype == torch.float64 else FLOAT32_GRADIENT
    assert found == pytest.approx(0.9 * share if 0.9 * share > 1 / 255 else 0.0, rel=tolerance)


def test_a_dilated_footprint_is_3dgs_gaussian() -> None:
    """3DGS: alpha is o exp(-d^2 / 2 (s^2 + 0.3)) at a distance of d pixels from a round Gaussian of s pixels."""
    camera, sigma = frontal(21, 21, 100.0), 0.7
    raster = cpu(
        means=torch.tensor([[0.0, 0.0, 4.0]]),
        log_scales=torch.full((1, 3), math.log(4.0 * sigma / 100.0)),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        opacity_logits=torch.tensor([math.log(0.9 / 0.1)]),
        sh_dc=torch.zeros(1, 3),
        sh_rest=torch.zeros(1, 0, 3),
        camera=camera,
        filter_2d=0.3,
        filter_2d_fades=False,
    )
    for dx, dy in ((0, 0), (1, 0), (1, 2), (-2, 1)):
        expected = 0.9 * math.exp(-0.5 * (dx * dx + dy * dy) / (sigma**2 + 0.3))
        assert float(raster.alpha[10 + dy, 10 + dx]) == pytest.approx(expected, rel=FLOAT32_GRADIENT)


@pytest.mark.parametrize("blurred", [False, True])
def test_a_dilated_gaussian_without_width_is_drawn_and_has_gradients(blurred: bool) -> None:
    """Seen along its plane, a flat Gaussian's footprint is a line: its determinant is 0 before it is dilated."""
    gaussians = scene(40, 9)
    gaussians["log_scales"] = torch.tensor([[-1.0, -30.0, -30.0]]).repeat(40, 1)
    gaussians["opacity_logits"] += 5
    if blurred:
        gaussians["blur"] = torch.linspace(0, 4, 40)
    outputs, gradients, _ = assert_agree(
        gaussians, camera=view(48, 40), geometry="none", filter_2d=0.3, filter_2d_fades=False
    )
    assert (outputs.alpha > 0.1).any() and gradients["means"].any()


@pytest.mark.parametrize("geometry", ["none", "distortion"])
def test_dilated_values_and_gradients_agree_with_the_reference(geometry: str) -> None:
    assert_agree(scene(50, 5), camera=view(), geometry=geometry, filter_2d=0.3, filter_2d_fades=False)
