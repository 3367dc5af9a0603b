"""Kernels on images of one pixel, one row, odd sizes and unusual channels."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from dofbench.kernels import load
from dofbench.optics.layered import layered_blur
from dofbench.stability.case import (
    KERNELS,
    SINGLE,
    SINGLE_ON_CPU,
    Case,
    Found,
    Setting,
    not_finite,
    off,
    refuses,
    values,
)
from dofbench.stability.comparisons import NAMED, RASTERIZED, SCATTERED, against_formula, against_reference
from dofbench.stability.oracle import ROUNDINGS
from dofbench.stability.samples import gaussians, picture, radii, size_name, straight

SIZES = ((1, 1), (1, 9), (9, 1), (3, 5), (17, 33))


def _scatter(setting: Setting, size: tuple[int, int]) -> Found:
    return against_formula(setting, picture(*size), radii(0.4, 6.0, *size))


def _layered(setting: Setting, size: tuple[int, int]) -> Found:
    image = picture(*size)
    found = values(
        layered_blur(setting.tensor(image), setting.tensor(radii(0.4, 6.0, *size)), setting.kernel("scatter"))
    )
    if found.shape != image.shape or not_finite(found):
        return Found(math.inf, 0.0)
    return Found(max(0.0, float(image.min() - found.min()), float(found.max() - image.max())), 64 * setting.eps)


def _rasterize(setting: Setting, size: tuple[int, int]) -> Found:
    return against_reference(setting, gaussians(), camera=straight(size[1], size[0]))


def _ssim(setting: Setting, size: tuple[int, int]) -> Found:
    a, b = picture(*size), picture(*size, seed=1)
    double = Setting("reference", "float64")
    exact = float(load("ssim", "reference", function="l1_ssim")(double.tensor(a), double.tensor(b), ssim_weight=0.2))
    found = float(setting.kernel("ssim", "l1_ssim")(setting.tensor(a), setting.tensor(b), ssim_weight=0.2))
    # Variances are differences of numbers up to 1; the division is by their sum with C2 = 9e-4.
    return Found(abs(found - exact), ROUNDINGS * setting.eps / (0.03 + 9e-4))


def _ssim_too_small(setting: Setting) -> Found:
    small = setting.tensor(picture(5, 5))
    return refuses(ValueError, lambda: setting.kernel("ssim")(small, small, border="valid"), "at least 11 x 11")


def _stereo(setting: Setting, size: tuple[int, int]) -> Found:
    grey, other = picture(*size)[..., 0], picture(*size, seed=3)[..., 0]
    maps = np.array([[[1.0, 0, 0, -0.7], [0, 1, 0, 0.2], [0, 0, 1, 0]]])
    planes = np.array([0.0, 1.0, 4.0])

    def sweep(kernel: Callable[..., Any], where: Setting) -> np.ndarray:
        return values(
            kernel(
                where.tensor(grey),
                where.tensor(other[None]),
                where.tensor(maps.astype(np.float32)),
                where.tensor(planes),
                radius=2,
                best=1,
            )
        )

    exact = sweep(load("stereo", "reference"), Setting("reference", "float64"))
    # The error of a correlation: rounded coordinates of up to 33 pixels, and variances down to the floor of 2e-5.
    return Found(off(sweep(setting.kernel("stereo"), setting), exact, 1.0), 33 * setting.eps / math.sqrt(2e-5))


def _channels(setting: Setting, count: int) -> Found:
    image, radius, scatter = picture(channels=count), setting.tensor(radii(0.4)), setting.kernel("scatter")
    together = values(scatter(setting.tensor(image), radius))
    apart = np.concatenate(
        [values(scatter(setting.tensor(image[..., k : k + 1]), radius)) for k in range(count)], axis=2
    )
    # How far the compiled kernel follows an edge depends on the brightest pixel of all channels that it processes
    # together.
    return Found(off(together, apart), (ROUNDINGS + radius.numel() / 2) * setting.eps + 2 * math.exp(-12.0))


def _no_pixels(setting: Setting) -> Found:
    empty = np.zeros((0, 5, 3), np.float32)
    return refuses(
        ValueError, lambda: setting.kernel("scatter")(setting.tensor(empty), setting.tensor(empty[..., 0])), "image"
    )


def _cases() -> tuple[Case, ...]:
    picture_case = partial(Case, "images")
    return (
        *(
            picture_case(
                f"scatter-{size_name(size)}",
                "scatter",
                f"{size_name(size)} pixels: the formula's result",
                SCATTERED,
                KERNELS,
                partial(_scatter, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"layered-{size_name(size)}",
                "layered",
                f"{size_name(size)} pixels: no lighter or darker than any",
                "64 roundings",
                SINGLE_ON_CPU,
                partial(_layered, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"rasterize-{size_name(size)}",
                "rasterize",
                f"{size_name(size)} pixels: as the float64 reference",
                RASTERIZED,
                SINGLE,
                partial(_rasterize, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"ssim-{size_name(size)}",
                "ssim",
                f"{size_name(size)} pixels: the float64 loss",
                "16 roundings over the least denominator",
                SINGLE,
                partial(_ssim, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"stereo-{size_name(size)}",
                "stereo",
                f"{size_name(size)} pixels: the float64 scores",
                "rounded coordinates over the least deviation",
                SINGLE_ON_CPU,
                partial(_stereo, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"channels-{count}",
                "scatter",
                f"{count} channels are blurred as each by itself",
                "16 roundings and one a pixel, twice exp(-12)",
                KERNELS,
                partial(_channels, count=count),
            )
            for count in (1, 2, 4, 5)
        ),
        picture_case(
            "no-pixels",
            "scatter",
            "an image without pixels is refused by name",
            NAMED,
            tuple(s for s in KERNELS if s.backend != "reference"),
            _no_pixels,
        ),
        picture_case(
            "ssim-5x5-valid",
            "ssim",
            "an image smaller than the window is refused by name",
            NAMED,
            KERNELS,
            _ssim_too_small,
        ),
    )


CASES = _cases()
