"""Invariants of image similarity: SSIM under exchange of images and of channels, stereo under exposure and shift."""

from __future__ import annotations

import numpy as np

from dofbench.evaluation.stability.case import KERNELS, Case, Found, Setting, off
from dofbench.evaluation.stability.comparisons import l1_ssim, sweep
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import picture
from dofbench.evaluation.stability.subject import Subject

BY_ONE = (-1.0, 0.0)  # a source that is shifted by the disparity


def _same_image(setting: Setting, image: np.ndarray) -> Found:
    given = setting.tensor(image)
    likeness = setting.kernel("ssim")(given, given)
    return Found(max(abs(float(l1_ssim(setting, given, given))), abs(float(likeness) - 1)), ROUNDINGS * setting.eps)


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


def _brightness(setting: Setting) -> Found:
    grey = picture()[..., 0] * 0.5 + 0.2
    planes = np.array([0.0, 1.0, 2.0])
    plain, found = (sweep(setting, grey, other, BY_ONE, planes) for other in (grey, 0.7 * grey + 0.05))
    # The floor of 2e-5 on variances of 0.02 has twice the effect on a variance of half the size; this isn't rounding.
    return Found(off(found, plain, 1.0), 2e-5 / (0.49 * 0.005) + 64 * setting.eps / 0.005)


def _correlation(setting: Setting) -> Found:
    grey = picture(40, 48)[..., 0]
    scores = sweep(setting, grey, np.roll(grey, -3, axis=1), BY_ONE, np.array([0.0, 3.0, 5.0]))
    beyond = max(0.0, float(np.abs(scores).max()) - 1)
    missed = float(np.count_nonzero(scores[6:-6, 6:-6].argmax(axis=2) != 1))
    return Found(missed + beyond, 64 * setting.eps / 0.005, f"{missed:.0f} pixels at another plane")


def _cases() -> tuple[Case, ...]:
    ssim = Subject("invariants", "ssim", KERNELS)
    stereo = Subject("invariants", "stereo", tuple(s for s in KERNELS if s.device == "cpu"))
    images = {"textured": picture(), "black": np.zeros((24, 32, 3)), "bright": 1e3 * picture()}
    return (
        *ssim.each(
            "ssim-of-itself-{image_label}",
            "an image is like itself: {image_label}",
            "16 roundings",
            _same_image,
            image=images,
        ),
        ssim.case(
            "ssim-symmetric",
            "which image comes first doesn't matter",
            "128 roundings: variances are differences of sums",
            _symmetric,
        ),
        ssim.case("ssim-channels", "three channels are the mean of each", "128 roundings", _channels),
        stereo.case(
            "stereo-brightness",
            "another exposure matches as well",
            "the variances' floor, and their rounding",
            _brightness,
        ),
        stereo.case(
            "stereo-shift",
            "scores lie in -1 ... 1, and are best at the true plane",
            "rounding of a variance of 0.005",
            _correlation,
        ),
    )


CASES = _cases()
