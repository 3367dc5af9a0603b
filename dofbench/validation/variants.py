"""The renderers that are compared, each with what it changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from dofbench.defocus import defocus_by_radius
from dofbench.lens import ApertureShape
from dofbench.validation.truth import Truth

Renderer = Callable[[Truth], np.ndarray]


def _render(truth: Truth, **options) -> np.ndarray:
    return defocus_by_radius(truth.sharp, truth.signed_radius, **{"gamma": truth.gamma, **options})[0]


def _same_area_hexagon(truth: Truth) -> np.ndarray:
    # A hexagon's area is 3 sqrt(3) / 2 of its corner radius squared.
    grown = truth.signed_radius * math.sqrt(math.pi / (1.5 * math.sqrt(3)))
    return defocus_by_radius(truth.sharp, grown, gamma=truth.gamma, shape=ApertureShape(6))[0]


# By name: (H, W, 3) encoded as the photograph is, so blur in another gamma is seen as it would be in a dataset.
VARIANTS: dict[str, Renderer] = {
    "no blur": lambda truth: truth.sharp,
    "scatter": _render,
    "scatter, algorithm1 (no area term)": partial(_render, energy="algorithm1"),
    "scatter, gamma 1": partial(_render, gamma=1.0),
    "scatter, gamma 2": partial(_render, gamma=2.0),
    "scatter, gamma 4": partial(_render, gamma=4.0),
    "scatter, hexagon of the same area": _same_area_hexagon,
    "layered, 4": partial(_render, renderer="layered", layers=4),
    "layered, 16": partial(_render, renderer="layered", layers=16),
    "layered, 64": partial(_render, renderer="layered", layers=64),
}
