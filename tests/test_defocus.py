"""Decode, scatter, encode: one photograph for methods, synthesis and evaluation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import strategies as st
from tolerances import FINITE_DIFFERENCE, FLOAT32_GRADIENT, FLOAT32_VALUE, HALF_LIT

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens
from dofbench.optics.defocus import defocus_by_radius, defocus_numpy, scatter_defocus
from dofbench.optics.tone import TOE, decode

gammas = st.sampled_from([1.0, 2.0, 2.2, 4.0])


def scene(seed: int = 0, height: int = 20, width: int = 31, largest: float = 5.0):
    """Encoded image with exact blacks and whites, and signed radius; float32."""
    rng = np.random.default_rng(seed)
    image = np.clip(rng.uniform(-0.1, 1.1, (height, width, 3)), 0, 1)
    radius = rng.uniform(-largest, largest, (height, width))
    return torch.from_numpy(image.astype(np.float32)), torch.from_numpy(radius.astype(np.float32))


def relative(found, expected) -> float:
    return float((found - expected).abs().max() / expected.abs().max())


# ------------------------------------------------------------------------------------------------ defocus


def test_no_aperture_is_the_image_bit_for_bit():
    image, _ = scene()
    for zero in (0.0, -0.0):
        blurred = scatter_defocus(image, torch.full(image.shape[:2], zero))
        assert torch.equal(blurred, image) and blurred.data_ptr() != image.data_ptr()


@pytest.mark.parametrize(
    ("blur", "form"),
    [
        (Blur(), "auto"),
        (Blur(gamma=2.0), "auto"),
        (Blur(gamma=4.0), "auto"),
        (Blur(alpha=2.0), "auto"),
        (Blur(energy="algorithm1"), "auto"),
        (Blur(), "linear"),
        (Blur(shape=ApertureShape(blades=6, rotation=0.2)), "auto"),
    ],
)
def test_cpu_agrees_with_the_reference(blur, form):
    image, radius = scene(1)
    gradient = torch.from_numpy(np.random.default_rng(2).standard_normal(image.shape))
    results = []
    for dtype, backend in ((torch.float64, "reference"), (torch.float32, "auto")):
        inputs = [t.to(dtype).detach().clone().requires_grad_() for t in (image, radius)]
        blurred = scatter_defocus(*inputs, blur, backend=backend, form=form)
        blurred.backward(gradient.to(dtype))
        results.append((blurred.detach().double(), *(t.grad.double() for t in inputs)))
    expected, found = results
    assert relative(found[0], expected[0]) < FLOAT32_VALUE
    assert relative(found[1], expected[1]) < FLOAT32_GRADIENT
    assert relative(found[2], expected[2]) < FLOAT32_GRADIENT


@pytest.mark.slow
def test_gradient_of_the_reference_by_finite_differences():
    image, radius = (t.double().requires_grad_() for t in scene(3, 4, 5, 2.0))
    inputs = (image.detach().clamp(0.05, 0.95).requires_grad_(), radius)
    torch.autograd.gradcheck(lambda c, s: scatter_defocus(c, s, backend="reference"), inputs, atol=FINITE_DIFFERENCE)


def test_blur_is_in_linear_light():
    """Black and white in equal parts, blurred far: half of the light, which is encoded 0.5 ** (1 / gamma)."""
    image = torch.zeros(40, 40, 3)
    image[:, ::2] = 1.0
    middle = scatter_defocus(image, torch.full((40, 40), 8.0), Blur(gamma=2.2))[20, 20]
    assert middle == pytest.approx(np.full(3, 0.5 ** (1 / 2.2)), abs=HALF_LIT)


def test_nothing_is_clipped_at_white():
    image, radius = torch.full((9, 9, 3), 3.0), torch.full((9, 9), 2.0)
    assert relative(scatter_defocus(image, radius), image) < FLOAT32_VALUE


def test_black_stays_black_and_trains():
    image = torch.zeros(8, 9, 3, requires_grad=True)
    radius = torch.full((8, 9), 1.5, requires_grad=True)
    blurred = scatter_defocus(image, radius)
    blurred.sum().backward()
    assert not blurred.any() and torch.isfinite(image.grad).all() and torch.isfinite(radius.grad).all()


def test_gradient_reaches_lens_and_disparity():
    image, _ = scene(4)
    disparity = torch.rand(image.shape[:2], generator=torch.Generator().manual_seed(5)).requires_grad_()
    aperture, focus = (torch.tensor(v, requires_grad=True) for v in (6.0, 0.4))
    (scatter_defocus(image, aperture * (disparity - focus)) ** 2).sum().backward()
    for tensor in (disparity, aperture, focus):
        assert torch.isfinite(tensor.grad).all() and tensor.grad.abs().max() > 0


def test_a_bad_radius_is_an_error_and_a_bad_colour_is_seen():
    image, radius = scene(6)
    spoiled = radius.clone()
    spoiled[3, 4] = math.nan
    with pytest.raises(FloatingPointError):
        scatter_defocus(image, spoiled)
    image[3, 4, 0] = math.nan
    assert torch.isnan(scatter_defocus(image, radius)[3, 4, 0])


# ------------------------------------------------------------------------------------------------ for datasets


def test_a_photograph_from_depth():
    image, _ = scene(7)
    depth = np.random.default_rng(8).uniform(1.0, 9.0, image.shape[:2]).astype(np.float32)
    lens = Lens(1.0, 0.3).physical(DisparityRange(1 / 9, 1.0), 200)
    encoded, linear = defocus_numpy(image.numpy(), depth, lens)
    assert encoded.dtype == linear.dtype == np.float32 and encoded.shape == linear.shape == image.shape
    radius = torch.from_numpy(lens.signed_radius(1.0 / depth.astype(np.float64), 31))
    expected = scatter_defocus(image.double(), radius, backend="reference")
    assert relative(torch.from_numpy(encoded).double(), expected) < FLOAT32_VALUE
    assert relative(torch.from_numpy(linear).double(), decode(expected, toe=TOE)) < FLOAT32_VALUE


def test_unknown_depth_is_infinitely_far():
    image, _ = scene(9)
    depth = np.full(image.shape[:2], 2.0, np.float32)
    depth[:, 10:] = 1e12
    spoiled = depth.copy()
    spoiled[:, 10:15], spoiled[:, 15:20], spoiled[:, 20:25], spoiled[:, 25:] = 0.0, np.inf, np.nan, -1.0
    lens = PhysicalLens(8.0, 0.5, 31)
    for found, expected in zip(
        defocus_numpy(image.numpy(), spoiled, lens), defocus_numpy(image.numpy(), depth, lens), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)


def test_a_photograph_without_aperture_is_the_original():
    image, _ = scene(10)
    encoded, linear = defocus_numpy(image.numpy(), np.ones(image.shape[:2]), PhysicalLens(0.0, 0.5, 31))
    assert np.array_equal(encoded, image.numpy())
    assert np.array_equal(linear, decode(image, toe=TOE).numpy())


def test_every_part_of_the_blur_reaches_the_kernel():
    image, radius = scene(11)
    plain = scatter_defocus(image, radius)
    for blur in (
        Blur(gamma=1.0),
        Blur(alpha=2.0),
        Blur(shape=ApertureShape(blades=3)),
        Blur(energy="algorithm1"),
    ):
        assert relative(scatter_defocus(image, radius, blur), plain) > 1e-3, blur
        assert np.array_equal(
            defocus_by_radius(image.numpy(), radius.numpy(), blur)[0], scatter_defocus(image, radius, blur)
        )


def test_a_renderer_is_refused_where_it_cannot_be():
    image, radius = scene(12)
    with pytest.raises(InputError, match="renderer: found layered, expected scatter"):
        scatter_defocus(image, radius, Blur(renderer="layered"))
    with pytest.raises(InputError, match="renderer: found thinlens, expected scatter or layered"):
        defocus_by_radius(image.numpy(), radius.numpy(), Blur(renderer="thinlens"))
