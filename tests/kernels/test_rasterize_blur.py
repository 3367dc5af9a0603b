"""The blur of single Gaussians: against the reference, a closed form, and invariants."""

import math

import numba
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from random_gaussians import assert_agree, assert_close, cpu, reference, render, scene, value_tolerance, view
from tolerances import BLUR_INTEGRAL, BLUR_OF_NEEDLES, FINITE_DIFFERENCE, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.cameras import Camera
from dofbench.runtime.raster import GEOMETRIES


def straight(x: float = 48.0, y: float = 40.0) -> Camera:
    """96 x 80 pixels, its axis through pixel position (x, y)."""
    return Camera(96, 80, 100.0, 100.0, x, y, np.eye(4))


def blurred(n: int, seed: int, largest: float) -> dict[str, torch.Tensor]:
    """A scene with blur; a third of the Gaussians has none, a seventh next to none."""
    blur = torch.rand(n, generator=torch.Generator().manual_seed(seed)) * largest
    blur[1::7] *= 1e-5
    blur[::3] = 0
    return {**scene(n, seed), "blur": blur}


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


@pytest.mark.parametrize("geometry,filter_2d", [("none", 0.1), ("depth", 0.0), ("distortion", 0.1)])
@pytest.mark.parametrize("largest", [0.3, 30.0, 1000.0])
def test_values_and_gradients_agree_with_the_reference(geometry, filter_2d, largest):
    assert_agree(
        blurred(61, 1, largest),
        camera=view(60, 50),
        geometry=geometry,
        filter_2d=filter_2d,
        filter_3d=torch.full((61,), 0.03),
        background=torch.tensor([0.2, 0.5, 0.1]),
    )


def test_needles():
    gaussians = blurred(40, 8, 10.0)
    gaussians["log_scales"] = torch.tensor([[1.0, -6.0, -7.0]]).repeat(40, 1)
    gaussians["opacity_logits"] += 5
    options = {"camera": view(48, 40), "geometry": "distortion"}
    outputs, gradients, _ = render(cpu, gaussians, torch.float32, **options)
    expected_outputs, expected, _ = render(reference, gaussians, torch.float64, **options)
    for name, output in outputs._asdict().items():
        assert_close(output, getattr(expected_outputs, name), value_tolerance(name), name)
    for name, gradient in gradients.items():
        assert_close(gradient, expected[name], BLUR_OF_NEEDLES if name == "blur" else FLOAT32_GRADIENT, name)


@pytest.mark.parametrize("filter_2d", [0.0, 0.1])
def test_reference_against_finite_differences(filter_2d):
    gaussians = {name: value.double() for name, value in blurred(8, 13, 9.0).items()}
    gaussians["log_scales"] += 1
    gaussians["opacity_logits"].clamp_(max=3)

    def loss(blur):
        inputs = {**gaussians, "blur": blur}
        outputs = reference(**inputs, camera=view(9, 7), geometry="distortion", filter_2d=filter_2d)
        weights = torch.Generator().manual_seed(2)
        return sum((o * torch.randn(o.shape, generator=weights, dtype=torch.float64)).sum() for o in outputs)

    # Away from 0, so that a step down is still a variance.
    blur = (gaussians["blur"] + 0.01).requires_grad_()
    (gradient,) = torch.autograd.grad(loss(blur), blur)
    assert gradient.abs().min() > 0
    step = 1e-6
    for k in range(len(blur)):
        move = torch.zeros_like(blur)
        move[k] = step
        with torch.no_grad():
            measured = (loss(blur + move) - loss(blur - move)) / (2 * step)
        assert abs(measured - gradient[k]) <= FINITE_DIFFERENCE * max(1.0, abs(gradient[k]))


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


def test_same_bits_on_any_number_of_threads():
    gaussians, camera = blurred(500, 15, 40.0), view(70, 50)
    threads = numba.get_num_threads()
    try:
        runs = []
        for count in (threads, 1):
            numba.set_num_threads(count)
            runs.append(render(cpu, gaussians, torch.float32, camera=camera, geometry="distortion"))
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(runs[0][0], runs[1][0], strict=True))
    assert all(torch.equal(runs[0][1][name], runs[1][1][name]) for name in gaussians)


@pytest.mark.parametrize(
    "value,error,found",
    [
        (torch.zeros(3), ValueError, r"blur: expected shape \(4,\), found \(3,\)"),
        (torch.zeros(4).double(), ValueError, "blur: expected contiguous torch.float32"),
        (torch.tensor([0.0, 1.0, -0.5, 2.0]), ValueError, "blur: expected at least 0, found -0.5"),
        (torch.tensor([0.0, 1.0, math.nan, 2.0]), FloatingPointError, r"blur\[2\]: found nan, expected a finite"),
        (torch.tensor([0.0, 1.0, math.inf, 2.0]), FloatingPointError, r"blur\[2\]: found inf, expected a finite"),
    ],
)
def test_wrong_blur_says_so(value, error, found):
    gaussians = scene(4, 18)
    gaussians["means"][:] = torch.tensor([0.0, 0.0, 4.0])
    gaussians["opacity_logits"][:] = 1
    with pytest.raises(error, match=found):
        cpu(**gaussians, camera=view(), blur=value)


def test_the_gradient_by_blur_is_only_taken_where_asked_for():
    gaussians = scene(20, 3)
    inputs = {name: value.requires_grad_() for name, value in gaussians.items()}
    blur = torch.full((20,), 2.0)
    cpu(**inputs, camera=view(), blur=blur).color.sum().backward()
    assert blur.grad is None
    assert inputs["means"].grad.any()
