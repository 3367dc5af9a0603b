"""A wall that faces the cameras, with a pattern that a formula gives: what a forward model of rays sees without a
field."""

from __future__ import annotations

from collections.abc import Callable

import torch
from made_up import frontal
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.training.fields.cube_rays import RaysSeen
from dofbench.training.fields.pixels import CameraTable

WIDTH, HEIGHT, FOCAL = 40, 30, 50.0


def cameras() -> list[Camera]:
    return [frontal(WIDTH, HEIGHT, FOCAL, (x, y, 0.0)) for x, y in ((0.0, 0.0), (0.2, -0.1))]


class PlaneScene:
    """A `RayTracer` of a wall at depth `z`. pattern: (R, 2) places on the wall, scene units, to (R, 3) encoded."""

    def __init__(self, z: float, pattern: Callable[[Tensor], Tensor]):
        self.cameras, self._z, self._pattern = CameraTable(cameras()), z, pattern
        self.scene = self  # the field that it traces

    def trace(self, origins: Tensor, directions: Tensor) -> RaysSeen:
        along = (self._z - origins[:, 2:]) / directions[:, 2:]
        where = origins[:, :2] + along * directions[:, :2]
        opacity, places = torch.ones(len(origins)), along.T
        return RaysSeen(self._pattern(where), opacity, opacity[None], places, opacity[None], places)

    def disparity(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        return 1 / seen.places[0]

    def features_met(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """The place on the wall."""
        return (origins + seen.places[0][:, None] * directions).detach()

    def features_along(self, origins: Tensor, directions: Tensor, count: int) -> Tensor:
        """Places along the ray up to the wall."""
        end = (self._z - origins[:, 2:]) / directions[:, 2:]
        shares = (torch.arange(count) + 0.5) / count
        return (origins[:, None] + (shares * end)[..., None] * directions[:, None]).detach()


def waves(where: Tensor) -> Tensor:
    """A smooth pattern with a slope everywhere."""
    x, y = where.unbind(1)
    return torch.stack([0.5 + 0.3 * torch.sin(3 * x + k) * torch.cos(2 * y - k) for k in range(3)], 1)
