"""Kernels on images of one pixel, one row, odd sizes and unusual channels."""

from __future__ import annotations

import math

import numpy as np

from dofbench.evaluation.stability.case import DOUBLE, KERNELS, SINGLE, SINGLE_ON_CPU, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import (
    against_formula,
    against_reference,
    l1_ssim,
    summed,
    sweep,
    within_the_image,
)
from dofbench.evaluation.stability.deviation import off, refuses, values
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import by_size, gaussians, picture, radii, straight

SIZES = by_size((1, 1), (1, 9), (9, 1), (3, 5), (17, 33))


def _scatter(setting: Setting, size: tuple[int, int]) -> Found:
    return against_formula(setting, picture(*size), radii(0.4, 6.0, *size))


def _layered(setting: Setting, size: tuple[int, int]) -> Found:
    return within_the_image(setting, picture(*size), radii(0.4, 6.0, *size))


def _rasterize(setting: Setting, size: tuple[int, int]) -> Found:
    return against_reference(setting, gaussians(), camera=straight(size[1], size[0]))


def _ssim(setting: Setting, size: tuple[int, int]) -> Found:
    a, b = picture(*size), picture(*size, seed=1)
    exact, found = (float(l1_ssim(where, where.tensor(a), where.tensor(b))) for where in (DOUBLE, setting))
    # Variances are differences of numbers up to 1; the division is by their sum with C2 = 9e-4.
    return Found(abs(found - exact), ROUNDINGS * setting.eps / (0.03 + 9e-4))


def _ssim_too_small(setting: Setting) -> Found:
    small = setting.tensor(picture(5, 5))
    return refuses(ValueError, lambda: setting.kernel("ssim")(small, small, border="valid"), "at least 11 x 11")


def _stereo(setting: Setting, size: tuple[int, int]) -> Found:
    grey, other = picture(*size)[..., 0], picture(*size, seed=3)[..., 0]
    planes = np.array([0.0, 1.0, 4.0])
    exact, found = (sweep(where, grey, other, (-0.7, 0.2), planes) for where in (DOUBLE, setting))
    # The error of a correlation: rounded coordinates of up to 33 pixels, and variances down to the floor of 2e-5.
    return Found(off(found, exact, 1.0), 33 * setting.eps / math.sqrt(2e-5))


def _channels(setting: Setting, count: int) -> Found:
    image, radius, scatter = picture(channels=count), setting.tensor(radii(0.4)), setting.kernel("scatter")
    together = values(scatter(setting.tensor(image), radius))
    apart = np.dstack([values(scatter(setting.tensor(image[..., k : k + 1]), radius)) for k in range(count)])
    # The compiled kernel truncates an edge by the brightest pixel of all channels that it processes together.
    return Found(off(together, apart), summed(setting, radius.numel()) + 2 * math.exp(-12.0))


def _no_pixels(setting: Setting) -> Found:
    empty = np.zeros((0, 5, 3), np.float32)
    given = setting.tensor(empty), setting.tensor(empty[..., 0])
    return refuses(ValueError, lambda: setting.kernel("scatter")(*given), "image")


def _cases() -> tuple[Case, ...]:
    scatter, ssim = (Subject("images", subject, KERNELS) for subject in ("scatter", "ssim"))
    layered, stereo = (Subject("images", subject, SINGLE_ON_CPU) for subject in ("layered", "stereo"))
    rasterize, loss = (Subject("images", subject, SINGLE) for subject in ("rasterize", "ssim"))
    compiled = Subject("images", "scatter", tuple(s for s in KERNELS if s.backend != "reference"))
    return (
        *scatter.each("scatter-{size_label}", _scatter, size=SIZES),
        *layered.each("layered-{size_label}", _layered, size=SIZES),
        *rasterize.each("rasterize-{size_label}", _rasterize, size=SIZES),
        *loss.each("ssim-{size_label}", _ssim, size=SIZES),
        *stereo.each("stereo-{size_label}", _stereo, size=SIZES),
        *scatter.each("channels-{count}", _channels, count=(1, 2, 4, 5)),
        compiled.case("no-pixels", _no_pixels),
        ssim.case("ssim-5x5-valid", _ssim_too_small),
    )


CASES = _cases()
