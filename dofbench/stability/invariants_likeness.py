"""Invariants of image similarity: SSIM under exchange of images and of channels, stereo under exposure and shift."""

from __future__ import annotations

from functools import partial

import numpy as np

from dofbench.stability.case import (
    KERNELS,
    Case,
    Found,
    Setting,
    off,
    values,
)
from dofbench.stability.oracle import ROUNDINGS
from dofbench.stability.samples import (
    picture,
)


def _same_image(setting: Setting, value: np.ndarray) -> Found:
    image = setting.tensor(value)
    loss = setting.kernel("ssim", "l1_ssim")(image, image, ssim_weight=0.2)
    likeness = setting.kernel("ssim")(image, image)
    return Found(max(abs(float(loss)), abs(float(likeness) - 1)), ROUNDINGS * setting.eps)


def _symmetric(setting: Setting) -> Found:
    a, b, ssim = setting.tensor(picture()), setting.tensor(picture(seed=1)), setting.kernel("ssim")
    # Variances of 0.07 to 0.08 are differences of numbers near 1/4, which costs one digit, in sums of 121 numbers.
    return Found(abs(float(ssim(a, b)) - float(ssim(b, a))), 8 * ROUNDINGS * setting.eps)


def _channels(setting: Setting) -> Found:
    a, b, ssim = picture(), picture(seed=1), setting.kernel("ssim")
    apart = [float(ssim(setting.tensor(a[..., k : k + 1]), setting.tensor(b[..., k : k + 1]))) for k in range(3)]
    return Found(
        abs(float(ssim(setting.tensor(a), setting.tensor(b))) - float(np.mean(apart))), 8 * ROUNDINGS * setting.eps
    )


def _sweep(setting: Setting, reference: np.ndarray, source: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Scores (H, W, D) of a source shifted by the disparity."""
    maps = np.array([[[1.0, 0, 0, -1.0], [0, 1, 0, 0], [0, 0, 1, 0]]])
    return values(
        setting.kernel("stereo")(
            setting.tensor(reference),
            setting.tensor(source[None]),
            setting.tensor(maps),
            setting.tensor(planes),
            radius=2,
            best=1,
        )
    )


def _brightness(setting: Setting) -> Found:
    grey = picture()[..., 0] * 0.5 + 0.2
    planes = np.array([0.0, 1.0, 2.0])
    plain, found = (_sweep(setting, grey, other, planes) for other in (grey, 0.7 * grey + 0.05))
    # The floor of 2e-5 on variances of 0.02 has twice the effect on a variance of half the size; this isn't rounding.
    return Found(off(found, plain, 1.0), 2e-5 / (0.49 * 0.005) + 64 * setting.eps / 0.005)


def _correlation(setting: Setting) -> Found:
    grey = picture(40, 48)[..., 0]
    scores = _sweep(setting, grey, np.roll(grey, -3, axis=1), np.array([0.0, 3.0, 5.0]))
    beyond = max(0.0, float(np.abs(scores).max()) - 1)
    missed = float(np.count_nonzero(scores[6:-6, 6:-6].argmax(axis=2) != 1))
    return Found(missed + beyond, 64 * setting.eps / 0.005, f"{missed:.0f} pixels at another plane")


def _cases() -> tuple[Case, ...]:
    rule = partial(Case, "invariants")
    return (
        *(
            rule(
                f"ssim-of-itself-{name}",
                "ssim",
                f"an image is like itself: {name}",
                "16 roundings",
                KERNELS,
                partial(_same_image, value=value),
            )
            for name, value in (("textured", picture()), ("black", np.zeros((24, 32, 3))), ("bright", 1e3 * picture()))
        ),
        rule(
            "ssim-symmetric",
            "ssim",
            "which image comes first doesn't matter",
            "128 roundings: variances are differences of sums",
            KERNELS,
            _symmetric,
        ),
        rule("ssim-channels", "ssim", "three channels are the mean of each", "128 roundings", KERNELS, _channels),
        rule(
            "stereo-brightness",
            "stereo",
            "another exposure matches as well",
            "the variances' floor, and their rounding",
            tuple(s for s in KERNELS if s.device == "cpu"),
            _brightness,
        ),
        rule(
            "stereo-shift",
            "stereo",
            "scores lie in -1 ... 1, and are best at the true plane",
            "rounding of a variance of 0.005",
            tuple(s for s in KERNELS if s.device == "cpu"),
            _correlation,
        ),
    )


CASES = _cases()
