"""The lenses that a training starts from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from dofbench.core.contracts import TrainingView
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange
from dofbench.training.common.lens_ties import lens_ties
from dofbench.training.common.lenses import LearnedLenses, LensOptions

_INSIDE = 0.02  # normalised disparity: foci start so far inside the range, since beyond its ends some have no gradient


def first_lenses(
    views: Sequence[TrainingView],
    disparity_range: DisparityRange,
    options: LensOptions,
    device: torch.device | str = "cpu",
) -> LearnedLenses:
    """The lenses of the views before any step. Raises InputError where the options need EXIF that isn't there."""
    ties = lens_ties(views, options.lens_per)
    lenses = LearnedLenses(len(views), disparity_range, options, ties, device)
    if options.lens_focus_from == "exif":
        lenses.start_foci(foci_by_exif(views, disparity_range, options.lens_init_focus))
    return lenses


def foci_by_exif(views: Sequence[TrainingView], disparity_range: DisparityRange, middle: float) -> list[float]:
    """Normalised disparity of each view's focus, in the ratios of 1 / distance in EXIF.

    EXIF's unit in scene units is unknown: it is chosen such that the median of the finite distances is at `middle`.
    Infinity is the far end of the range; a view whose distance is unknown has `middle`. Raises InputError without any
    finite distance.
    """
    distances = [None if view.exif is None else view.exif.focus_distance for view in views]
    written = [None if distance is None else 1 / distance for distance in distances]
    finite = [disparity for disparity in written if disparity]
    if not finite:
        expected = "a finite focus distance of some training photograph, or lens_focus_from=option"
        raise InputError("option lens_focus_from", "exif, and no focus distance in EXIF", expected)
    unit = (disparity_range.q_min + middle * disparity_range.extent) / float(np.median(finite))
    return [
        middle if one is None else float(np.clip(disparity_range.normalise(unit * one), _INSIDE, 1 - _INSIDE))
        for one in written
    ]
