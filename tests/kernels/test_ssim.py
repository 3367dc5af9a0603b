"""SSIM kernels: the definition against scikit-image, the CPU kernel against the definition."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import torch
from backends import GPU, compiled
from hypothesis import example, given
from hypothesis import strategies as st
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE, FLOAT64_VALUE, SSIM_NEAR_ONE

from dofbench.runtime.ops import load

reference, kernel = load("ssim", "reference"), load("ssim", "cpu")
reference_l1, kernel_l1 = (load("ssim", backend, function="l1_ssim") for backend in ("reference", "cpu"))


def pair(height: int, width: int, noise: float, seed: int = 0, channels: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    """(prediction, target), float32: smooth waves with a flat patch, and the same with noise outside it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    phase = rng.uniform(0, 6, channels)
    target = 0.5 + 0.4 * np.sin(x[..., None] / 4 + phase) * np.cos(y[..., None] / 5 + phase)
    prediction = np.clip(target + noise * rng.standard_normal(target.shape), 0, 1)
    flat = slice(height // 3, height // 2), slice(width // 3, width // 2)
    target[flat] = prediction[flat] = 0.9
    return torch.tensor(prediction, dtype=torch.float32), torch.tensor(target, dtype=torch.float32)


def value_and_gradient(function, prediction, target, **options) -> tuple[float, torch.Tensor]:
    prediction = prediction.clone().requires_grad_()
    value = function(prediction, target, **options)
    value.backward()
    return value.item(), prediction.grad.double()


def assert_agrees(function, definition, prediction, target, **options) -> None:
    """Value and gradient of a float32 function against the definition in float64."""
    exact_options = {name: o.double() if torch.is_tensor(o) else o for name, o in options.items()}
    value, gradient = value_and_gradient(function, prediction, target, **options)
    exact, exact_gradient = value_and_gradient(definition, prediction.double(), target.double(), **exact_options)
    assert value == pytest.approx(exact, abs=FLOAT32_VALUE)
    scale = exact_gradient.abs().max().item()
    torch.testing.assert_close(gradient, exact_gradient, rtol=0, atol=FLOAT32_GRADIENT * scale)


# ---- the definition ----


def test_reference_equals_scikit_image() -> None:
    from skimage.metrics import structural_similarity

    prediction, target = (image.double() for image in pair(40, 57, 0.1))
    expected = structural_similarity(
        prediction.numpy(),
        target.numpy(),
        gaussian_weights=True,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
    )
    assert reference(prediction, target, border="valid").item() == pytest.approx(expected, abs=FLOAT64_VALUE)


def test_a_weight_that_acts_on_both_terms_weighs_every_pixel_s_similarity() -> None:
    """Eq. 13: the map of similarities is scikit-image's, the weighted mean is written out."""
    from skimage.metrics import structural_similarity

    prediction, target = (image.double() for image in pair(30, 41, 0.1))
    weight = torch.rand(30, 41, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    _, similarity = structural_similarity(
        prediction.numpy(),
        target.numpy(),
        gaussian_weights=True,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )
    unlike = (weight.numpy()[..., None] * (1 - similarity))[5:-5, 5:-5].mean()
    absolute = (weight.numpy()[..., None] * (prediction - target).abs().numpy()).mean()
    found = reference_l1(prediction, target, ssim_weight=0.3, weight=weight, weigh_all=True, border="valid")
    assert found.item() == pytest.approx(0.7 * absolute + 0.3 * unlike, abs=FLOAT64_VALUE)


def test_same_border_pads_with_zeros() -> None:
    """Images laid into a wide black frame: the pixels of the image alone have the padded mean."""
    prediction, target = (image.double() for image in pair(20, 23, 0.1))
    framed = [torch.nn.functional.pad(image, (0, 0, 10, 10, 10, 10)) for image in (prediction, target)]
    inner = [image[5:-5, 5:-5] for image in framed]
    # Cropping the 5-pixel border off the inner frame leaves the windows centred on the image's own pixels.
    expected = reference(prediction, target).item()
    assert reference(*inner, border="valid").item() == pytest.approx(expected, abs=FLOAT64_VALUE)


@pytest.mark.parametrize("border", ["same", "valid"])
def test_reference_gradient_is_the_derivative(border: str) -> None:
    prediction, target = (image.double() for image in pair(13, 12, 0.1, channels=1))
    weight = torch.rand(13, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    prediction.requires_grad_()
    functions = (
        lambda p: reference(p, target, border=border),
        lambda p: reference_l1(p, target, ssim_weight=0.3, weight=weight, border=border),
        lambda p: reference_l1(p, target, ssim_weight=0.3, weight=weight, weigh_all=True, border=border),
        lambda p: reference_l1(p, target, ssim_weight=0.3, weight=weight, edge_weight=2.0, border=border),
        lambda p: reference_l1(p, target, ssim_weight=0.3, weight=weight, weigh_all=True, edge_weight=2.0),
    )
    for function in functions:
        assert torch.autograd.gradcheck(function, prediction, fast_mode=True)


@pytest.mark.parametrize("function", [reference_l1, kernel_l1])
def test_edges_have_no_error_where_all_pixels_err_alike(function) -> None:
    """A brightness that is off everywhere leaves all edges as they are; a step of 1/4 in one of 8 columns, twice as
    heavy as the others on its right, has its height over 7 pairs of columns; the weight acts on edges if it acts on
    all of the loss."""
    target = torch.full((6, 8, 3), 0.25)
    error, step = torch.full_like(target, 0.125), torch.zeros_like(target)
    step[:, 3:] = 0.25
    weight = torch.ones(6, 8)
    weight[:, 3:] = 2.0

    def edges(change, **weights):
        values = [function(target + change, target, ssim_weight=0.0, edge_weight=e, **weights) for e in (0.0, 4.0)]
        return (values[1] - values[0]).item()

    assert edges(error) == 0.0
    assert edges(step) == pytest.approx(4 * 0.25 / 7, abs=FLOAT32_VALUE)
    assert edges(step.transpose(0, 1)[:6, :6].repeat(1, 2, 1)[:, :8]) == pytest.approx(4 * 0.25 / 5, abs=FLOAT32_VALUE)
    assert edges(step, weight=weight, weigh_all=True) == pytest.approx(4 * 0.25 * 1.5 / 7, abs=FLOAT32_VALUE)
    assert edges(step, weight=weight) == pytest.approx(4 * 0.25 / 7, abs=FLOAT32_VALUE)


@pytest.mark.parametrize("both", [False, True])
def test_edges_by_finite_differences(both: bool) -> None:
    prediction, target = (image.double() for image in pair(30, 41, 0.1))
    weight = torch.rand(30, 41, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    shares = weight.numpy() if both else np.ones((30, 41))
    options = {"ssim_weight": 0.0, "weight": weight, "weigh_all": both}
    error, expected = (prediction - target).numpy(), 0.0
    for axis in (0, 1):
        kernel_of_two = np.ones((2, 1)) if axis == 0 else np.ones((1, 2))
        means = scipy.signal.convolve2d(shares, kernel_of_two / 2, mode="valid")
        expected += (means[..., None] * np.abs(np.diff(error, axis=axis))).mean()
    plain, found = (reference_l1(prediction, target, edge_weight=e, **options) for e in (0, 2.5))
    assert (found - plain).item() == pytest.approx(2.5 * expected, abs=FLOAT64_VALUE)


# ---- the CPU kernel ----


@given(
    height=st.integers(1, 20),
    width=st.integers(1, 20),
    channels=st.sampled_from([1, 3]),
    weighted=st.booleans(),
    both=st.booleans(),
    seed=st.integers(0, 99),
)
def test_edges_of_the_kernel_agree_with_the_definition(height, width, channels, weighted, both, seed) -> None:
    """Levels of 8 bits: their differences are exact, so a slope's sign is the same in both precisions."""
    rng = np.random.default_rng(seed)
    images = (torch.tensor(rng.integers(0, 256, (height, width, channels)) / 256, dtype=torch.float32) for _ in "pt")
    weight = torch.rand(height, width, generator=torch.Generator().manual_seed(seed)) if weighted else None
    # Without the two other terms the edges' error isn't hidden by theirs.
    options = {"ssim_weight": 0.0, "weight": weight, "weigh_all": both, "edge_weight": 50.0}
    assert_agrees(kernel_l1, reference_l1, *images, **options)


@given(
    height=st.integers(1, 40),
    width=st.integers(1, 30) | st.sampled_from([255, 256, 257, 300]),  # a tile is 256 pixels wide
    noise=st.sampled_from([0.0, 1e-3, 0.05, 1.0]),
    border=st.sampled_from(["same", "valid"]),
    weighted=st.sampled_from(["nothing", "l1", "both"]),
    seed=st.integers(0, 99),
)
@example(height=16, width=512, noise=0.05, border="valid", weighted="l1", seed=0)
@example(height=11, width=13, noise=0.0, border="valid", weighted="nothing", seed=4)
@example(height=33, width=257, noise=0.05, border="same", weighted="nothing", seed=0)
@example(height=33, width=257, noise=0.05, border="same", weighted="both", seed=0)
@example(height=16, width=512, noise=0.05, border="valid", weighted="both", seed=0)
@example(height=11, width=11, noise=0.05, border="valid", weighted="nothing", seed=0)
def test_kernel_agrees_with_the_definition(height, width, noise, border, weighted, seed) -> None:
    if border == "valid":
        height, width = max(height, 11), max(width, 11)
    prediction, target = pair(height, width, noise, seed)
    if not noise:
        # Equal images have gradient zero, which leaves no scale to compare by: off by a tenth, everywhere.
        target = target + 0.1
    shares = torch.rand(height, width, generator=torch.Generator().manual_seed(seed))
    weight, both = (None if weighted == "nothing" else shares), weighted == "both"
    assert_agrees(kernel, reference, prediction, target, border=border)
    for ssim_weight in (0.2, 1.0):  # the second shows errors of the similarity that the first term would hide
        options = {"border": border, "ssim_weight": ssim_weight, "weight": weight, "weigh_all": both}
        assert_agrees(kernel_l1, reference_l1, prediction, target, **options)


@pytest.mark.parametrize(
    ("size", "options"),
    [
        ((11, 90), {"border": "same"}),  # two blocks across
        ((11, 90), {"border": "valid"}),
        ((12, 15), {"edge_weight": 2.0}),
        ((12, 15), {"weigh_all": True, "edge_weight": 0.5}),
        ((12, 15), {"border": "valid", "weigh_all": True}),
        ((1, 5), {"edge_weight": 1.0, "data_range": 2.0, "window": 5, "sigma": 1.0}),
        ((5, 1), {"edge_weight": 1.0, "data_range": 2.0, "window": 5, "sigma": 1.0}),
    ],
)
@pytest.mark.parametrize("gpu", [GPU])
def test_the_gpu_agrees_with_the_definition(gpu: str, size: tuple[int, int], options: dict) -> None:
    prediction, target = pair(*size, 0.1, seed=1)
    weight, function = torch.rand(size), load("ssim", gpu, function="l1_ssim")
    assert_agrees(function, reference_l1, prediction, target, ssim_weight=0.3, weight=weight, **options)


def test_without_weights_there_is_nothing_to_weigh_by() -> None:
    prediction, target = pair(20, 24, 0.1)
    for function in (kernel_l1, reference_l1):
        plain = function(prediction, target, ssim_weight=0.2)
        assert function(prediction, target, ssim_weight=0.2, weigh_all=True) == plain


@pytest.mark.parametrize("border", ["same", "valid"])
def test_kernel_agrees_at_other_settings(border: str) -> None:
    prediction, target = (255 * image for image in pair(21, 34, 0.1, channels=1))
    assert_agrees(kernel, reference, prediction, target, border=border, window=7, sigma=1.0, data_range=255.0)


def test_upstream_gradient_scales() -> None:
    prediction, target = pair(20, 20, 0.1)
    _, once = value_and_gradient(kernel_l1, prediction, target, ssim_weight=0.2)
    _, thrice = value_and_gradient(lambda *a, **k: 3 * kernel_l1(*a, **k), prediction, target, ssim_weight=0.2)
    torch.testing.assert_close(thrice, 3 * once, rtol=FLOAT32_VALUE, atol=0)


def test_equal_images() -> None:
    image, _ = pair(30, 30, 0.1)
    value, gradient = value_and_gradient(kernel, image, image.clone())
    assert value == 1.0
    assert gradient.abs().max() == 0.0


@compiled
def test_loss_keeps_its_digits_near_convergence(backend: str) -> None:
    prediction, target = pair(24, 24, 0.002)
    loss = load("ssim", backend, function="l1_ssim")(prediction, target, ssim_weight=1.0).item()
    exact = reference_l1(prediction.double(), target.double(), ssim_weight=1.0).item()
    assert np.log10(exact) < -3
    assert loss == pytest.approx(exact, rel=SSIM_NEAR_ONE)


def test_noncontiguous_images() -> None:
    prediction, target = pair(20, 24, 0.1)
    turned = [image.transpose(0, 1) for image in (prediction, target)]
    assert_agrees(kernel, reference, *turned)


def test_a_prediction_changed_before_the_backward_pass_is_an_error() -> None:
    prediction, target = pair(20, 20, 0.1)
    leaf = prediction.requires_grad_()
    image = leaf * 1.0
    value = kernel(image, target)
    image.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        value.backward()


@pytest.mark.parametrize("border", ["same", "valid"])
@pytest.mark.parametrize("place", [(0, 0, 0), (10, 15, 2)])
def test_nan_comes_through(border: str, place: tuple[int, int, int]) -> None:
    prediction, target = pair(20, 30, 0.1)
    prediction[place] = torch.nan
    for function in (kernel, reference):
        value, gradient = value_and_gradient(function, prediction, target, border=border)
        assert np.isnan(value) and gradient[place].isnan()


@pytest.mark.parametrize("function", [kernel, reference])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, t: ((p[1:], t), {}), "one shape"),
        (lambda p, t: ((p[..., 0], t[..., 0]), {}), r"\(H, W, C\)"),
        (lambda p, t: ((p, t.double()), {}), "ssim target: expected torch.float32 on cpu like prediction"),
        (lambda p, t: ((p.byte(), t.byte()), {}), "found uint8 on cpu"),
        (lambda p, t: ((p, t.requires_grad_()), {}), "without gradient"),
        (lambda p, t: ((p[:10], t[:10]), {"border": "valid"}), "at least 11 x 11"),
        (lambda p, t: ((p, t), {"border": "reflect"}), "'same' or 'valid'"),
        (lambda p, t: ((p, t), {"window": 10}), "odd"),
        (lambda p, t: ((p, t), {"sigma": 0.0}), "sigma: expected a positive"),
        (lambda p, t: ((p, t), {"data_range": -1.0}), "data range: expected a positive"),
    ],
)
def test_what_cannot_be_compared_is_refused(function, change, message) -> None:
    arguments, options = change(*pair(20, 20, 0.1))
    with pytest.raises(ValueError, match=message):
        function(*arguments, **options)


@pytest.mark.parametrize("function", [kernel_l1, reference_l1])
def test_weights_that_do_not_fit_are_refused(function) -> None:
    prediction, target = pair(20, 20, 0.1)
    for weight in (torch.ones(20, 20, 3), torch.ones(20, 19), torch.ones(20, 20, dtype=torch.float64)):
        with pytest.raises(ValueError, match="ssim weight"):
            function(prediction, target, ssim_weight=0.2, weight=weight)
    with pytest.raises(ValueError, match="without gradient"):
        function(prediction, target, ssim_weight=0.2, weight=torch.ones(20, 20, requires_grad=True))


def test_the_kernel_takes_float32_alone() -> None:
    prediction, target = (image.double() for image in pair(20, 20, 0.1))
    with pytest.raises(ValueError, match="found float64 on cpu, expected float32 on cpu"):
        kernel(prediction, target)
