"""Errors of learned lenses: delta_A and delta_F as in DoF-Gaussian, and delta_R, their error in CoC radius.

Estimates are converted to the dataset's units without any fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dofbench.core.lens import DisparityRange, Lens, PhysicalLens

DO_NOTHING = Lens(aperture=0.5, focus=0.5)  # a constant prediction, as a baseline


class ViewLensErrors(NamedTuple):
    """One view's |A - Â|, |F - F̂| (normalised) and mean |R - R̂| (px; NaN when no depth is known)."""

    delta_a: float
    delta_f: float
    delta_r: float


@dataclass(frozen=True)
class LensErrors:
    """delta_a, delta_f: means over views, normalised. delta_r: mean over all pixels of all views, px."""

    delta_a: float
    delta_f: float
    delta_r: float
    per_view: dict[str, ViewLensErrors]


def lens_errors(
    true: Mapping[str, Lens],
    estimated: Mapping[str, PhysicalLens | None],
    disparity_range: DisparityRange,
    width: int | Mapping[str, int],
    depths: Mapping[str, np.ndarray | None],
) -> LensErrors:
    """Errors of the `estimated` lenses of the views in `true`.

    disparity_range: of the dataset, the unit of A and F. width: of the images, pixels, one for all or by view. depths:
    (H, W) by view, scene units, 0 where unknown; such pixels aren't part of delta_r. Raises ValueError without views,
    and for a view without estimate or depth.
    """
    if not true:
        raise ValueError("lens errors: expected at least one view, found none")
    per_view: dict[str, ViewLensErrors] = {}
    radius_sum, pixels = 0.0, 0
    for name, lens in true.items():
        guess, depth = estimated.get(name), depths.get(name)
        if guess is None or depth is None:
            raise ValueError(f"lens errors: expected an estimate and a depth for view {name}, found none")
        found, own = Lens.from_physical(guess, disparity_range), _width(width, name)
        disparity = 1.0 / depth[depth != 0].astype(np.float64)
        radius = np.abs(lens.physical(disparity_range, own).signed_radius(disparity, own))
        errors = np.abs(radius - np.abs(guess.signed_radius(disparity, own)))
        total = float(errors.sum())
        per_view[name] = ViewLensErrors(
            delta_a=abs(lens.aperture - found.aperture),
            delta_f=abs(lens.focus - found.focus),
            delta_r=total / errors.size if errors.size else math.nan,
        )
        radius_sum, pixels = radius_sum + total, pixels + errors.size
    return LensErrors(
        delta_a=math.fsum(view.delta_a for view in per_view.values()) / len(per_view),
        delta_f=math.fsum(view.delta_f for view in per_view.values()) / len(per_view),
        delta_r=radius_sum / pixels if pixels else math.nan,
        per_view=per_view,
    )


def do_nothing_errors(
    true: Mapping[str, Lens],
    disparity_range: DisparityRange,
    width: int | Mapping[str, int],
    depths: Mapping[str, np.ndarray | None],
) -> LensErrors:
    """Errors of the constant prediction A = F = 0.5 for every view. Arguments as in `lens_errors`."""
    guesses = {name: DO_NOTHING.physical(disparity_range, _width(width, name)) for name in true}
    return lens_errors(true, guesses, disparity_range, width, depths)


def _width(width: int | Mapping[str, int], name: str) -> int:
    return width if isinstance(width, int) else width[name]
