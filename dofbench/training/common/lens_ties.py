"""Which photographs share the aperture or the focus of their lenses.

A lens of focal length f at f-number N has an opening f / N wide, and its circles of confusion in pixels grow with the
focal length in pixels. So photographs that were taken together may share their aperture (pixels x scene unit), up to a
factor that EXIF states, while each has its own focus. Where cameras differ, as in portrait and landscape, the factor
of the focal length in image widths is part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dofbench.core.contracts import TrainingView
from dofbench.core.errors import InputError
from dofbench.core.lens import framing

LensPer = Literal["view", "aperture", "group", "exif", "scene"]


@dataclass(frozen=True)
class Ties:
    """aperture, focus: per view, the index of its aperture and of its focus; views with equal indices share it.

    opening: per view, the factor from the shared aperture to the view's own.
    """

    aperture: tuple[int, ...]
    focus: tuple[int, ...]
    opening: tuple[float, ...]

    @property
    def tied(self) -> bool:
        """Whether some views share an aperture but not their focus."""
        return max(self.aperture) != max(self.focus)

    @staticmethod
    def untied(count: int) -> Ties:
        """Ties of so many views that share nothing."""
        every = tuple(range(count))
        return Ties(every, every, (1.0,) * count)


def lens_ties(views: Sequence[TrainingView], per: LensPer) -> Ties:
    """The ties of the views.

    per: "view", nothing is shared; "scene", the whole lens; "aperture", one aperture for all photographs, and a focus
    each; "group", an aperture for each f-number; "exif", one product of aperture and f-number. Raises InputError for
    "group" and "exif" if a photograph has no f-number.
    """
    count = len(views)
    each, one = tuple(range(count)), (0,) * count
    if per == "view":
        return Ties.untied(count)
    # Circles of confusion are learned in units of the image's width.
    openings = np.array([framing(view.camera) for view in views])
    if per == "scene":
        return Ties(one, one, _about_median(openings))
    numbers = [None if view.exif is None else view.exif.f_number for view in views]
    known = [number for number in numbers if number is not None]
    if per != "aperture" and len(known) < count:
        name = views[numbers.index(None)].name
        raise InputError(
            "option lens_per",
            f"{per}, and view {name} without an f-number",
            "EXIF with the f-number of every photograph, or lens_per=aperture",
        )
    if per == "exif":
        lengths = [None if view.exif is None else view.exif.focal_length for view in views]
        openings = openings * np.array([1.0 if length is None else length for length in lengths]) / np.array(known)
    different = sorted(set(known))
    shared = tuple(different.index(number) for number in known) if per == "group" else one
    return Ties(shared, each, _about_median(openings))


def _about_median(openings: np.ndarray) -> tuple[float, ...]:
    return tuple(float(opening) for opening in openings / np.median(openings))
