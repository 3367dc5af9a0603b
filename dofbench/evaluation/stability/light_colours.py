"""A photograph's own colours: none, strong ones, and channels that are no numbers."""

from __future__ import annotations

import math

import numpy as np

from dofbench.evaluation.stability.case import (
    DOUBLE,
    KERNELS,
    Case,
    Found,
    Setting,
    differing,
    gradient_at,
    off,
    values,
)
from dofbench.evaluation.stability.comparisons import EXACT
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, picture
from dofbench.evaluation.stability.subject import Subject


def _colour_lost(setting: Setting, bad: float) -> Found:
    """A channel that is none makes its own pixel's channels none, and no other's."""
    image = picture().astype(np.float32)
    image[3, 4, 1] = bad
    found = values(setting.kernel("colours")(setting.tensor(image), setting.tensor(np.full((3, 4), 0.5))))
    lost = ~np.isfinite(found).any(axis=2)
    return Found(float(lost.sum() != 1 or not lost[3, 4]), 0.0)


def _identity(setting: Setting) -> Found:
    """Without any change the picture comes back bit for bit."""
    image = picture().astype(np.float32)
    found = setting.kernel("colours")(setting.tensor(image), setting.tensor(np.zeros((3, 4))))
    return Found(differing(found, image), 0.0)


def _mixed_colours(setting: Setting, largest: float) -> Found:
    """Values and gradients of a strong change are the definition's."""
    results = []
    for one in (setting, DOUBLE):
        change = np.random.default_rng(7).uniform(-largest, largest, (3, 4)).astype(np.float32)
        given = [one.tensor(array, gradient=True) for array in (picture().astype(np.float32), change)]
        found = one.kernel("colours")(*given)
        found.sum().backward()
        results.append([values(found), *(gradient_at(leaf) for leaf in given)])
    worst = max(off(found, exact) for found, exact in zip(*results, strict=True))
    return Found(worst, (2 * ROUNDINGS + HEIGHT * WIDTH) * setting.eps)


def coloured() -> tuple[Case, ...]:
    """The cases, for the group of light."""
    colours = Subject("light", "colours", KERNELS)
    return (
        colours.case("colours-unchanged", "a photograph without a change of its own is the picture", EXACT, _identity),
        *colours.each(
            "colours-{bad:g}",
            "a channel of {bad:g} is seen in its pixel, and nowhere else",
            "0: neither swallowed nor spread",
            _colour_lost,
            bad=(math.nan, math.inf),
        ),
        *colours.each(
            "colours-changed-by-{largest:g}",
            "values and gradients are the definition's with a change of up to {largest:g}",
            "32 roundings, and one for each pixel that is added up",
            _mixed_colours,
            largest=(0.1, 1e6),
        ),
    )
