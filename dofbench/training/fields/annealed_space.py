"""The space that training begins with, where views are from all around: without what is near the cameras.

Few cameras see what stands right before one of them. At the first steps, when nothing is where it belongs yet, it would
be painted there soonest, for each camera its own picture, and nothing takes such a haze away again. RegNeRF (Niemeyer
et al., CVPR 2022, sample space annealing) therefore has rays begin farther away at first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.training.common.supervision import all_disparities
from dofbench.training.fields.cube_rays import Space
from dofbench.training.fields.space import depth_at, space_for
from dofbench.training.fields.unbounded import Unbounded

_UNTIL = 0.256  # of the training, when the whole space is there; RegNeRF after 256 steps of a longer one
_FIRST = 0.5  # of the way to the near plane, from the start; RegNeRF


@dataclass(frozen=True, eq=False)
class AnnealedSpace:
    """A space, and the depth from which its near plane comes. whole: the space in the end. middle: the median depth of
    what the cameras see, scene units."""

    whole: Space
    middle: float

    @staticmethod
    def of(cameras: Sequence[Camera], points: PointCloud) -> AnnealedSpace:
        """See `space_for`; points: what the cameras see."""
        disparities = all_disparities(points, cameras)
        return AnnealedSpace(space_for(cameras, points.xyz, disparities), depth_at(disparities, 0.5))

    def at(self, progress: float) -> Space:
        """What is trained at this share of the training. A frustum is there from the start: its near plane lies behind
        all cameras."""
        if not isinstance(self.whole, Unbounded):
            return self.whole
        share = min(max(progress / _UNTIL, _FIRST), 1)
        return replace(self.whole, near=self.middle + share * (self.whole.near - self.middle))
