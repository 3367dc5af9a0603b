"""Focus and aperture in the course of a film: keyframes with easing."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens

Easing = Literal["smooth", "linear", "in", "out", "hold"]
# From 0 to 1 between two keyframes: with even speed, from rest to rest, from rest, to rest, or in a jump at the end.
_EASED: dict[str, Callable[[float], float]] = {
    "smooth": lambda x: x * x * (3 - 2 * x),
    "linear": lambda x: x,
    "in": lambda x: x * x,
    "out": lambda x: x * (2 - x),
    "hold": lambda x: float(x >= 1),
}


@dataclass(frozen=True)
class Key:
    """A value at a moment, 0 to 1. easing: of the way to it from the keyframe before. Raises InputError."""

    moment: float
    value: float
    easing: Easing = "smooth"

    def __post_init__(self) -> None:
        if not 0 <= self.moment <= 1:
            raise InputError("keyframe", f"moment {self.moment:g}", "0 to 1")
        if not math.isfinite(self.value):
            raise InputError("keyframe", f"value {self.value}", "a finite number")
        if self.easing not in get_args(Easing):
            raise InputError("keyframe", f"easing {self.easing!r}", f"one of {', '.join(get_args(Easing))}")


class Track:
    """A number in the course of a film. keys: at least one, with ascending moments; before the first and after the last
    its value holds. Raises InputError."""

    def __init__(self, keys: Sequence[Key]):
        if not keys:
            raise InputError("keyframes", "none", "at least one")
        moments = [key.moment for key in keys]
        if any(one >= two for one, two in itertools.pairwise(moments)):
            raise InputError("keyframes", f"moments {', '.join(f'{one:g}' for one in moments)}", "ascending moments")
        self._keys, self._moments = tuple(keys), moments

    @staticmethod
    def even(values: Sequence[float], easing: Easing = "smooth") -> Track:
        """The values at evenly spaced moments, the first at 0 and the last at 1."""
        last = max(len(values) - 1, 1)
        return Track([Key(index / last, value, easing) for index, value in enumerate(values)])

    def at(self, moment: float) -> float:
        """The value at a moment."""
        index = bisect.bisect_right(self._moments, moment)
        if index == 0:
            return self._keys[0].value
        if index == len(self._keys):
            return self._keys[-1].value
        before, after = self._keys[index - 1], self._keys[index]
        share = _EASED[after.easing]((moment - before.moment) / (after.moment - before.moment))
        return before.value + share * (after.value - before.value)


@dataclass(frozen=True, eq=False)
class LensTrack:
    """The lens of a film. opening: half the width of the lens's opening, scene units, so that blur grows with a zoom as
    it does in a camera. focus: disparity in focus, 1 / scene unit, so that a focus pull looks even; or a point, (3,),
    that stays in focus."""

    opening: Track
    focus: Track | np.ndarray

    def lens(self, moment: float, camera: Camera) -> PhysicalLens:
        """The lens on this camera. A point behind the camera is focused at infinity."""
        if isinstance(self.focus, Track):
            disparity = self.focus.at(moment)
        else:
            _, depth = camera.project(self.focus[None])
            disparity = 1.0 / float(depth[0]) if depth[0] > 0 else 0.0
        return PhysicalLens(self.opening.at(moment) * camera.fx, disparity, camera.width)
