"""The ops `mix` (a kernel for each pixel) and `colours` (an affine colour correction): large values, NaN, one pixel."""

from __future__ import annotations

import math

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability.case import DOUBLE, KERNELS, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import differing, gradient_at, not_finite, off, values
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, picture

_SIZE = 5


def _logits(largest: float) -> np.ndarray:
    return np.random.default_rng(5).uniform(-largest, largest, (HEIGHT, WIDTH, _SIZE**2)).astype(np.float32)


def _mixed(setting: Setting, image: np.ndarray, logits: np.ndarray) -> tuple[Tensor, list[Tensor | None]]:
    """The mixture, and the gradients of its sum of squares with respect to image and logits."""
    given = [setting.tensor(array, gradient=True) for array in (image, logits)]
    mixed = setting.kernel("mix")(*given)
    mixed.square().sum().backward()
    return mixed, [tensor.grad for tensor in given]


def _like_the_definition(setting: Setting, largest: float) -> Found:
    image, logits = picture().astype(np.float32), _logits(largest)
    mixed, gradients = _mixed(setting, image, logits)
    exact, expected = _mixed(DOUBLE, image, logits)
    pairs = zip([mixed, *gradients], [exact, *expected], strict=True)
    worst = max(off(a, b) for a, b in pairs if a is not None and b is not None)
    # A weight is the exponential of a difference of logits, whose rounding is a share of the larger of them.
    return Found(worst, (2 * ROUNDINGS + _SIZE**2 + 2 * largest) * setting.eps)


def _one_neighbour(setting: Setting, ahead: float) -> Found:
    """The logit of the neighbour two to the right and one up is so large that all other weights are 0."""
    image = picture().astype(np.float32)
    logits = np.zeros((HEIGHT, WIDTH, _SIZE**2), np.float32)
    logits[..., 1 * _SIZE + 4] = ahead
    mixed, gradients = _mixed(setting, image, logits)
    expected = np.zeros_like(image)
    expected[1:, :-2] = image[:-1, 2:]
    return Found(differing(mixed, expected.astype(values(mixed).dtype)) + not_finite(*gradients), 0.0)


def _not_a_number(setting: Setting, bad: float) -> Found:
    """A logit of NaN or infinity makes its own pixel NaN, and no other."""
    logits = _logits(1.0)
    logits[3, 4, 7] = bad
    found = values(_mixed(setting, picture().astype(np.float32), logits)[0])
    lost = np.isnan(found).all(axis=2)
    return Found(float(lost.sum() != 1 or not lost[3, 4]), 0.0)


def _single_pixel(setting: Setting) -> Found:
    """The neighbours of the only pixel are black."""
    mixed, gradients = _mixed(setting, np.ones((1, 1, 3), np.float32), np.zeros((1, 1, 9), np.float32))
    return Found(off(mixed, np.full((1, 1, 3), 1 / 9)) + not_finite(*gradients), ROUNDINGS * setting.eps)


def _colour_lost(setting: Setting, bad: float) -> Found:
    """A channel that isn't finite affects its own pixel only."""
    image = picture().astype(np.float32)
    image[3, 4, 1] = bad
    found = values(setting.kernel("colours")(setting.tensor(image), setting.tensor(np.full((3, 4), 0.5))))
    lost = ~np.isfinite(found).any(axis=2)
    return Found(float(lost.sum() != 1 or not lost[3, 4]), 0.0)


def _identity(setting: Setting) -> Found:
    """A correction of zeros returns the image."""
    image = picture().astype(np.float32)
    found = setting.kernel("colours")(setting.tensor(image), setting.tensor(np.zeros((3, 4))))
    return Found(differing(found, image), 0.0)


def _mixed_colours(setting: Setting, largest: float) -> Found:
    """Values and gradients of a strong correction are the definition's."""
    results = []
    for one in (setting, DOUBLE):
        change = np.random.default_rng(7).uniform(-largest, largest, (3, 4)).astype(np.float32)
        given = [one.tensor(array, gradient=True) for array in (picture().astype(np.float32), change)]
        found = one.kernel("colours")(*given)
        found.sum().backward()
        results.append([values(found), *(gradient_at(leaf) for leaf in given)])
    worst = max(off(found, exact) for found, exact in zip(*results, strict=True))
    return Found(worst, (2 * ROUNDINGS + HEIGHT * WIDTH) * setting.eps)


def mixing() -> tuple[Case, ...]:
    """The cases, for the group "light"."""
    mix, colours = (Subject("light", subject, KERNELS) for subject in ("mix", "colours"))
    return (
        *mix.each("mix-{largest:g}", _like_the_definition, largest=(1.0, 1000.0)),
        *mix.each("mix-one-neighbour-{ahead:g}", _one_neighbour, ahead=(1000.0, 1e38)),
        *mix.each("mix-{bad:g}", _not_a_number, bad=(math.nan, math.inf)),
        mix.case("mix-one-pixel", _single_pixel),
        colours.case("colours-unchanged", _identity),
        *colours.each("colours-{bad:g}", _colour_lost, bad=(math.nan, math.inf)),
        *colours.each("colours-changed-by-{largest:g}", _mixed_colours, largest=(0.1, 1e6)),
    )
