"""Filter and blur of single Gaussians: closed forms and invariants."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import frontal
from random_gaussians import assert_close, cpu, reference, render, scene, view
from tolerances import BLUR_INTEGRAL, FLOAT32_GRADIENT, FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.runtime.raster import GEOMETRIES


def straight(x: float = 48.0, y: float = 40.0) -> Camera:
    """96 x 80 pixels, its axis through pixel position (x, y)."""
    return Camera(96, 80, 100.0, 100.0, x, y, np.eye(4))


def lone(opacity: float, pixels: float, squeeze: float = 1.0):
    """One Gaussian on the axis of a straight camera, `pixels` wide and `squeeze` times as high."""
    depth = 4.0
    size = math.log(pixels * depth / 100)
    return {
        "means": torch.tensor([[0.0, 0.0, depth]]),
        "log_scales": torch.tensor([[size, size + math.log(squeeze), size]]),
        "quaternions": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        "opacity_logits": torch.tensor([math.log(opacity / (1 - opacity))]),
        "sh_dc": torch.zeros(1, 3),
        "sh_rest": torch.zeros(1, 0, 3),
    }


@given(st.integers(0, 2**31), st.integers(1, 70), st.sampled_from(GEOMETRIES), st.booleans())
def test_no_blur_anywhere_is_none_bit_for_bit(seed, n, geometry, filtered):
    gaussians = scene(n, seed)
    options = {"camera": view(40, 33), "geometry": geometry, "filter_2d": 0.1 if filtered else 0.0}
    without = render(cpu, gaussians, torch.float32, **options)
    zero = render(cpu, {**gaussians, "blur": torch.zeros(n)}, torch.float32, **options)
    assert all(torch.equal(a, b) for a, b in zip(without[0], zero[0], strict=True) if a is not None)
    assert all(torch.equal(gradient, zero[1][name]) for name, gradient in without[1].items())
    assert torch.equal(without[2].radii, zero[2].radii)
    assert torch.equal(without[2].abs_grad_2d, zero[2].abs_grad_2d)


@given(
    st.floats(0.1, 0.3), st.floats(1.5, 3.0), st.floats(0.3, 1.0), st.floats(0, 64), st.floats(0, 1), st.floats(0, 1)
)
def test_a_lone_faint_gaussian_keeps_its_integral(opacity, pixels, squeeze, blur, x, y):
    gaussian, camera = lone(opacity, pixels, max(squeeze, 1.5 / pixels)), straight(48 + x, 40 + y)
    sharp, spread = (cpu(**gaussian, camera=camera, blur=b).color.sum() for b in (None, torch.tensor([blur])))
    assert abs(float(spread / sharp) - 1) < BLUR_INTEGRAL


@pytest.mark.parametrize("blur", [0.0, 0.5, 4.0, 25.0, 100.0])
def test_a_round_gaussian_has_the_closed_form(blur):
    """alpha = o s^2 / (s^2 + b) exp(-d^2 / 2 (s^2 + b)) out to where the exponential is 1 / 255 o, in every tile."""
    opacity, pixels = 0.6, 1.7
    alpha = cpu(**lone(opacity, pixels), camera=straight(51.3, 34.8), filter_2d=0.0, blur=torch.tensor([blur])).alpha
    x, y = np.meshgrid(np.arange(96) + 0.5 - 51.3, np.arange(80) + 0.5 - 34.8)
    variance = pixels**2 + blur
    fall = np.exp(-(x**2 + y**2) / (2 * variance))
    expected = torch.from_numpy(opacity * pixels**2 / variance * fall)
    edge = torch.from_numpy(fall * 255 * opacity)
    inside, outside = edge > 1.001, edge < 0.999
    assert (alpha[outside] == 0).all()
    assert_close(alpha[inside], expected[inside], FLOAT32_VALUE, "alpha")


def test_depth_and_normals_are_those_without_blur():
    gaussian = lone(0.8, 4.0)
    gaussian["quaternions"] = torch.tensor([[0.9, 0.3, -0.2, 0.1]])
    gaussian["log_scales"][0, 2] -= 5
    sharp = cpu(**gaussian, camera=straight(), geometry="distortion")
    spread = cpu(**gaussian, camera=straight(), geometry="distortion", blur=torch.tensor([20.0]))
    both = sharp.alpha > 0.01
    assert both.sum() < (spread.alpha > 0).sum() / 2
    assert_close(spread.depth[both], sharp.depth[both], FLOAT32_VALUE, "depth")
    assert_close(spread.median_depth[both], sharp.median_depth[both], FLOAT32_VALUE, "median depth")
    sharp, spread = (raster.normal[both] / raster.alpha[both][:, None] for raster in (sharp, spread))
    assert_close(spread, sharp, FLOAT32_VALUE, "normal")


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
