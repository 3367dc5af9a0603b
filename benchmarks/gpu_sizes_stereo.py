"""Sizes of a view of plane-sweep stereo that `gpu_model.py` predicts times of."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

RADIUS = 3  # pixels of the window around its centre, dofbench/learning/priors/stereo.py
SCALES = 3  # sizes of the picture at which a view is swept, each half the one before
CHECKED = 32  # views that a view's depth is checked against
SCRATCH, LARGEST_GRID = 2**26, 65535  # kernels/stereo/gpu.py


@dataclass(frozen=True)
class StereoSizes:
    """A view's picture, pixels, its planes, and how many other views it is swept with. coarse_width, coarse_height,
    coarse_planes: of the level whose scores are mixed in; 0 at the coarsest."""

    name: str
    width: int
    height: int
    planes: int
    sources: int
    coarse_width: int = 0
    coarse_height: int = 0
    coarse_planes: int = 0

    @property
    def pixels(self) -> int:
        """Of the picture."""
        return self.width * self.height

    @property
    def scores(self) -> int:
        """One for each pixel and plane."""
        return self.pixels * self.planes

    @property
    def wide(self) -> int:
        """Columns of the sums, a window's margin on both sides."""
        return self.width + 2 * RADIUS

    @cached_property
    def sweeps(self) -> int:
        """Launches of each kernel of the sweep: sums of so many planes at a time as a cache holds."""
        of_plane = 4 * 3 * self.sources * self.height * self.wide
        together = max(1, min(LARGEST_GRID // self.sources, SCRATCH // of_plane))
        return math.ceil(self.planes / together)

    @property
    def together(self) -> float:
        """Planes of a launch, the mean."""
        return self.planes / self.sweeps


def levels(view: StereoSizes) -> tuple[StereoSizes, ...]:
    """The view at each of its scales, the coarsest first: half as many pixels along each side have half as many
    planes."""
    found = [
        replace(
            view,
            width=view.width >> level,
            height=view.height >> level,
            planes=math.ceil((view.planes - 1) / 2**level) + 1,
        )
        for level in range(SCALES)
    ]
    mixed = [
        replace(fine, coarse_width=coarse.width, coarse_height=coarse.height, coarse_planes=coarse.planes)
        for fine, coarse in pairwise(found)
    ]
    return (found[-1], *reversed(mixed))
