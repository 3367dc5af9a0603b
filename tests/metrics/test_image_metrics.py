"""Each image metric against an independent computation or a value known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import (
    DELTA_E_BY_FORMULA,
    FLIP_IN_FLOAT32,
    FLOAT32_VALUE,
    FLOAT64_VALUE,
    PUBLISHED_COLOURS,
)

from dofbench.core.images import read_image
from dofbench.core.similarity import psnr, ssim
from dofbench.evaluation.metrics.flip import PIXELS_PER_DEGREE, flip, flip_map
from dofbench.evaluation.metrics.image_metrics import delta_e, gmsd, ms_ssim, scale_count, ssim_uniform7


def pair(height: int, width: int, noise: float = 0.1, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(prediction, truth) in [0, 1]: blotches of several sizes, and the same with noise."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    truth = sum(gaussian_filter(rng.standard_normal((height, width, 3)), (size, size, 0)) * size for size in (1, 3, 9))
    truth = np.clip(0.5 + 0.2 * truth, 0, 1)
    return np.clip(truth + noise * rng.standard_normal(truth.shape), 0, 1), truth


def level(*colour: float) -> np.ndarray:
    """A small image of one colour."""
    return np.broadcast_to(np.array(colour, dtype=np.float64), (16, 20, 3)).copy()


# ---- PSNR ----


@given(seed=st.integers(0, 99), noise=st.sampled_from([0.001, 0.1, 1.0]))
def test_psnr_equals_scikit_image(seed: int, noise: float) -> None:
    from skimage.metrics import peak_signal_noise_ratio

    prediction, truth = pair(13, 17, noise, seed)
    expected = peak_signal_noise_ratio(truth, prediction, data_range=1.0)
    assert psnr(prediction, truth) == pytest.approx(expected, rel=FLOAT64_VALUE)


def test_psnr_by_hand() -> None:
    assert psnr(level(0.5, 0.5, 0.5), level(0.6, 0.6, 0.6)) == pytest.approx(20.0, rel=FLOAT64_VALUE)
    assert psnr(level(0, 0, 0), level(1, 1, 1)) == 0.0
    assert psnr(level(0.2, 0.4, 0.6), level(0.2, 0.4, 0.6)) == math.inf


# ---- SSIM ----

SIMILARITIES = {  # metric -> (smallest side, scikit-image's options, scale and offset of its images)
    ssim: (11, {"gaussian_weights": True, "use_sample_covariance": False, "data_range": 1.0}, (1, 0)),
    ssim_uniform7: (7, {"data_range": 2.0}, (2, -1)),  # as the authors' script calls it
}


@pytest.mark.parametrize("metric", SIMILARITIES)
@given(
    height=st.integers(11, 40),
    width=st.integers(11, 40),
    noise=st.sampled_from([0.001, 0.1, 1.0]),
    seed=st.integers(0, 99),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_ssim_equals_scikit_image(metric, height: int, width: int, noise: float, seed: int, dtype: type) -> None:
    from skimage.metrics import structural_similarity

    smallest, options, (scale, offset) = SIMILARITIES[metric]
    size = height - 11 + smallest, width - 11 + smallest
    prediction, truth = (image.astype(dtype) for image in pair(*size, noise, seed))
    images = (scale * image.astype(np.float64) + offset for image in (prediction, truth))
    expected = structural_similarity(*images, channel_axis=2, **options)
    assert metric(prediction, truth) == pytest.approx(expected, abs=FLOAT64_VALUE)


def test_ssim_of_flat_images_by_hand() -> None:
    a, b, c1 = 0.2, 0.7, 0.01**2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    assert ssim(level(a, a, a), level(b, b, b)) == pytest.approx(expected, abs=FLOAT64_VALUE)


def test_ssim_of_the_authors_by_hand() -> None:
    """Flat images: the luminance term alone, from mid-grey; a picture and its negative are opposite."""
    a, b, c1 = 0.2 - 0.5, 0.7 - 0.5, 0.01**2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    assert ssim_uniform7(level(0.2, 0.2, 0.2), level(0.7, 0.7, 0.7)) == pytest.approx(expected, abs=FLOAT64_VALUE)
    assert expected < 0 < ssim(level(0.2, 0.2, 0.2), level(0.7, 0.7, 0.7))
    with pytest.raises(ValueError, match="at least 7 x 7"):
        ssim_uniform7(np.zeros((6, 9, 3)), np.zeros((6, 9, 3)))


# ---- MS-SSIM ----


def plain_ms_ssim(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Written out from the paper with two-dimensional windows and no shared code."""
    from scipy.signal import convolve2d

    y, x = np.mgrid[-5:6, -5:6]
    window = np.exp(-(x**2 + y**2) / (2 * 1.5**2))
    window /= window.sum()
    weights = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333]
    values = []
    for channel in range(3):
        a, b, factors = prediction[..., channel], truth[..., channel], []
        while min(a.shape) >= 11 and len(factors) < 5:
            mean_a, mean_b, aa, bb, ab = (convolve2d(m, window, "valid") for m in (a, b, a * a, b * b, a * b))
            structure = (2 * (ab - mean_a * mean_b) + 9e-4) / (aa - mean_a**2 + bb - mean_b**2 + 9e-4)
            luminance = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
            factors.append((structure.mean(), (luminance * structure).mean()))
            a, b = (convolve2d(m, np.full((2, 2), 0.25), "valid")[::2, ::2] for m in (a, b))
        used = weights[: len(factors)]
        terms = [factor for factor, _ in factors[:-1]] + [factors[-1][1]]
        values.append(math.prod(term ** (w / sum(used)) for term, w in zip(terms, used, strict=True)))
    return sum(values) / 3


@pytest.mark.parametrize("size", [(176, 180), (177, 191), (175, 200), (50, 47), (22, 23), (21, 40), (11, 12)])
def test_ms_ssim_equals_the_plain_one(size: tuple[int, int]) -> None:
    prediction, truth = pair(*size, noise=0.1)
    assert ms_ssim(prediction, truth) == pytest.approx(plain_ms_ssim(prediction, truth), abs=FLOAT64_VALUE)


def test_ms_ssim_scales() -> None:
    sides = {10: 0, 11: 1, 21: 1, 22: 2, 87: 3, 88: 4, 175: 4, 176: 5, 4000: 5}
    assert {side: scale_count(side, 5000) for side in sides} == sides


def test_ms_ssim_with_one_scale_is_ssim_by_channel() -> None:
    prediction, truth = pair(20, 30)
    assert ms_ssim(prediction, truth) == pytest.approx(ssim(prediction, truth), abs=FLOAT64_VALUE)


def test_ms_ssim_of_a_negative_is_zero() -> None:
    stripes = np.zeros((64, 64, 3))
    stripes[:, ::2] = 1
    assert ms_ssim(1 - stripes, stripes) == 0.0


# ---- GMSD ----


def plain_gmsd(prediction: np.ndarray, truth: np.ndarray) -> float:
    """As the authors' program does it: 'same' convolutions of values of 0 ... 255."""
    from scipy.signal import convolve2d

    across = np.array([[1, 0, -1]] * 3) / 3
    gradients = []
    for image in (prediction, truth):
        luma = 255 * (0.299 * image[..., 0] + 0.587 * image[..., 1] + 0.114 * image[..., 2])
        # Full convolution cut so that entry (0, 0) covers pixels 0 and 1, MATLAB's "same" for an even kernel.
        small = convolve2d(luma, np.full((2, 2), 0.25))[1:, 1:][::2, ::2]
        gx, gy = (convolve2d(small, kernel, "same") for kernel in (across, across.T))
        gradients.append(np.sqrt(gx**2 + gy**2))
    a, b = gradients
    return float(np.std((2 * a * b + 170) / (a**2 + b**2 + 170), ddof=1))


@pytest.mark.parametrize("size", [(40, 60), (41, 33), (3, 3)])
def test_gmsd_equals_the_plain_one(size: tuple[int, int]) -> None:
    prediction, truth = pair(*size)
    assert gmsd(prediction, truth) == pytest.approx(plain_gmsd(prediction, truth), abs=FLOAT64_VALUE)


def test_gmsd_sees_blur() -> None:
    from scipy.ndimage import gaussian_filter

    _, truth = pair(60, 60)
    scores = [gmsd(gaussian_filter(truth, (s, s, 0)), truth) for s in (0.5, 1.0, 2.0)]
    assert 0 < scores[0] < scores[1] < scores[2]


# ---- FLIP ----


def test_flip_extremes() -> None:
    black, white = level(0, 0, 0), level(1, 1, 1)
    assert flip(white, white) == 0.0
    assert 0.95 < flip(black, white) <= 1.0
    assert flip(black, white) == flip(white, black)


def of_the_authors(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W) float32: the error map of their package, which has no wheel for some Pythons and processors."""
    package = pytest.importorskip("flip_evaluator")
    images = (np.ascontiguousarray(image, np.float32) for image in (truth, prediction))
    found, _, parameters = package.evaluate(*images, "LDR", applyMagma=False, computeMeanError=False)
    assert parameters["ppd"] == pytest.approx(PIXELS_PER_DEGREE, rel=FLOAT32_VALUE)
    return found.reshape(truth.shape[:2])


@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    noise=st.sampled_from([0.001, 0.1, 1.0]),
    seed=st.integers(0, 99),
    stretched=st.sampled_from([1.0, 1.5]),  # to values outside [0, 1], which count as 0 and 1
)
def test_flip_equals_its_authors_package(height: int, width: int, noise: float, seed: int, stretched: float) -> None:
    prediction, truth = (0.5 + stretched * (image - 0.5) for image in pair(height, width, noise, seed))
    expected = of_the_authors(prediction, truth)
    found = flip_map(prediction, truth)
    np.testing.assert_allclose(found, expected, rtol=0, atol=FLIP_IN_FLOAT32)
    assert flip(prediction, truth) == pytest.approx(found.mean(), rel=FLOAT64_VALUE)


@pytest.mark.parametrize("colours", [np.eye(3), np.indices((2, 2, 2)).reshape(3, 8).T])
def test_flip_equals_its_authors_package_where_colours_are_pure(colours: np.ndarray) -> None:
    """The largest differences, and the curve's bend."""
    rng = np.random.default_rng(5)
    prediction, truth = (colours[rng.integers(0, len(colours), (40, 50))].astype(np.float64) for _ in range(2))
    np.testing.assert_allclose(
        flip_map(prediction, truth), of_the_authors(prediction, truth), rtol=0, atol=FLIP_IN_FLOAT32
    )


def test_flip_equals_its_authors_package_on_photographs(real_data: Callable[[str], Path]) -> None:
    """And to the digits that tables print. A real view against itself blurred, and against its neighbour."""
    from scipy.ndimage import gaussian_filter

    first, second = (read_image(path)[::2, ::2] for path in sorted((real_data("llff_fern") / "images_8").iterdir())[:2])
    for prediction in (gaussian_filter(first, (2, 2, 0)), second):
        expected = of_the_authors(prediction, first)
        np.testing.assert_allclose(flip_map(prediction, first), expected, rtol=0, atol=FLIP_IN_FLOAT32)
        assert f"{flip(prediction, first):.4f}" == f"{expected.mean(dtype=np.float64):.4f}"


def test_flip_of_flat_images_by_hand() -> None:
    """No edges, so the colour difference alone: that in lightness, compressed, and scaled below the curve's bend."""
    darker, lighter = (116 * ((one + 0.055) / 1.055) ** (2.4 / 3) - 16 for one in (0.4, 0.45))
    green, blue = (
        np.array([lightness, lightness / 100 * a, lightness / 100 * b])  # Hunt's adjustment
        for lightness, a, b in [
            (87.737, -86.183, 83.188),
            (32.303, 79.198, -107.850),
        ]  # CIELAB of sRGB's primaries, D65
    )
    largest = (abs(green[0] - blue[0]) + math.hypot(*(green - blue)[1:])) ** 0.7
    expected = (lighter - darker) ** 0.7 * 0.95 / (0.4 * largest)
    assert flip(level(0.4, 0.4, 0.4), level(0.45, 0.45, 0.45)) == pytest.approx(expected, rel=PUBLISHED_COLOURS)


def test_flip_averages_over_the_eye_not_over_pixels() -> None:
    """A fine chequerboard against its mean is less visible than a coarse one of the same PSNR."""
    y, x = np.mgrid[:64, :64]
    boards = [np.repeat((((x // n + y // n) % 2) * 0.5 + 0.25)[..., None], 3, axis=2) for n in (1, 16)]
    grey = np.full((64, 64, 3), 0.5)
    assert flip(boards[0], grey) < flip(boards[1], grey)


# ---- CIEDE2000 ----


def lab_of_srgb(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 and CIE 1976, written out."""
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = linear @ matrix.T / np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def test_delta_e_reads_pixels_as_srgb() -> None:
    import colour

    prediction, truth = pair(20, 20)
    expected = colour.difference.delta_E_CIE2000(lab_of_srgb(prediction), lab_of_srgb(truth)).mean()
    assert delta_e(prediction, truth) == pytest.approx(expected, abs=DELTA_E_BY_FORMULA)


def test_delta_e_of_greys_by_hand() -> None:
    """Neutral colours differ in lightness alone, so the formula shrinks to dL / S_L; black on white has 100."""
    assert delta_e(level(0, 0, 0), level(1, 1, 1)) == pytest.approx(100.0, abs=DELTA_E_BY_FORMULA)
    dark, light = lab_of_srgb(level(0.3, 0.3, 0.3))[0, 0, 0], lab_of_srgb(level(0.6, 0.6, 0.6))[0, 0, 0]
    middle = ((dark + light) / 2 - 50) ** 2
    expected = (light - dark) / (1 + 0.015 * middle / math.sqrt(20 + middle))
    assert delta_e(level(0.3, 0.3, 0.3), level(0.6, 0.6, 0.6)) == pytest.approx(expected, abs=DELTA_E_BY_FORMULA)
