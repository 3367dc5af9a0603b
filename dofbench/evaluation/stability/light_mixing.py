"""Pixels mixed from their neighbours by weights of their own: logits that differ without bound, NaN, one pixel."""

from __future__ import annotations

import math

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability.case import DOUBLE, KERNELS, Case, Found, Setting, differing, not_finite, off, values
from dofbench.evaluation.stability.comparisons import EXACT
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, picture
from dofbench.evaluation.stability.subject import Subject

_SIZE = 5
_SUMMED = "32 roundings, and one for each of the 25 neighbours"


def _logits(largest: float) -> np.ndarray:
    return np.random.default_rng(5).uniform(-largest, largest, (HEIGHT, WIDTH, _SIZE**2)).astype(np.float32)


def _mixed(setting: Setting, image: np.ndarray, logits: np.ndarray) -> tuple[Tensor, list[Tensor | None]]:
    """(the mixture, the gradients of its sum of squares by image and logits)."""
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
    """The logit of the neighbour two to the right and one up is so far ahead that the others weigh nothing."""
    image = picture().astype(np.float32)
    logits = np.zeros((HEIGHT, WIDTH, _SIZE**2), np.float32)
    logits[..., 1 * _SIZE + 4] = ahead
    mixed, gradients = _mixed(setting, image, logits)
    expected = np.zeros_like(image)
    expected[1:, :-2] = image[:-1, 2:]
    return Found(differing(mixed, expected.astype(values(mixed).dtype)) + not_finite(*gradients), 0.0)


def _not_a_number(setting: Setting, bad: float) -> Found:
    """A logit that is none makes its own pixel NaN, and no other."""
    logits = _logits(1.0)
    logits[3, 4, 7] = bad
    found = values(_mixed(setting, picture().astype(np.float32), logits)[0])
    lost = np.isnan(found).all(axis=2)
    return Found(float(lost.sum() != 1 or not lost[3, 4]), 0.0)


def _single_pixel(setting: Setting) -> Found:
    """Its neighbours are black: it keeps its own weight's share."""
    mixed, gradients = _mixed(setting, np.ones((1, 1, 3), np.float32), np.zeros((1, 1, 9), np.float32))
    return Found(off(mixed, np.full((1, 1, 3), 1 / 9)) + not_finite(*gradients), ROUNDINGS * setting.eps)


def mixing() -> tuple[Case, ...]:
    """The cases, for the group of light."""
    mix = Subject("light", "mix", KERNELS)
    return (
        *mix.each(
            "mix-{largest:g}",
            "values and gradients are the definition's with logits up to {largest:g}",
            _SUMMED + ", and the rounding of the logits",
            _like_the_definition,
            largest=(1.0, 1000.0),
        ),
        *mix.each(
            "mix-one-neighbour-{ahead:g}",
            "a logit ahead by {ahead:g} moves the picture",
            EXACT,
            _one_neighbour,
            ahead=(1000.0, 1e38),
        ),
        *mix.each(
            "mix-{bad:g}",
            "a logit of {bad:g} is seen at its pixel, and nowhere else",
            "0: neither swallowed nor spread",
            _not_a_number,
            bad=(math.nan, math.inf),
        ),
        mix.case("mix-one-pixel", "an image of one pixel", "16 roundings", _single_pixel),
    )
