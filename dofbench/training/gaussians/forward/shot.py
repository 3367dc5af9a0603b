"""How one photograph is taken: camera and lens.

A lens is given as the signed circle of confusion `slope * d + offset` in units of 2 % of the width, d being the
normalised disparity (`learning/lenses.py`); slope and offset are tensors in training and numbers in rendering.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.ops import load

_CLIPPED = 1e-5, 1.0  # released code
_FREE = -math.inf, math.inf


@dataclass(frozen=True, eq=False)
class Shot:
    """The camera, the lens, and the range that its disparities refer to.

    narrowed: Eq. 11's factor on the aperture as a function of the distance from the focus (`out_of_focus`), or None.
    clipped: whether normalised disparities are clipped to 1e-5 to 1 (released code), where they then have no gradient.
    number: of the training photograph, None for a rendering.
    """

    camera: Camera
    bounds: DisparityRange
    slope: Tensor | float
    offset: Tensor | float
    narrowed: Callable[[Tensor], Tensor] | None = None
    clipped: bool = False
    number: int | None = None

    @staticmethod
    def through(lens: PhysicalLens, camera: Camera) -> Shot:
        """A camera with a lens that is known in scene units."""
        slope = lens.aperture / (COC_FRACTION * lens.width)
        return Shot(camera, DisparityRange(0.0, 1.0), slope, -slope * lens.focus_disparity)

    def radius(self, disparity: Tensor) -> Tensor:
        """Signed circle of confusion, pixels, of disparities (1 / scene unit)."""
        radius = self._whole(disparity)
        return radius if self.narrowed is None else radius * self.narrowed(self.out_of_focus(disparity))

    @torch.no_grad()
    def circles(self, disparity: Tensor) -> Tensor:
        """Radii, pixels, of the circles of confusion of disparities (1 / scene unit), with the aperture not
        narrowed."""
        return self._whole(disparity).abs()

    def out_of_focus(self, disparity: Tensor) -> Tensor:
        """|normalised disparity - focus|, without gradient."""
        slope, offset = (
            value.detach().to(disparity) if isinstance(value, Tensor) else beside(disparity, value)
            for value in (self.slope, self.offset)
        )
        focus = torch.where(slope == 0, 0.0, -offset / slope)
        normalised: Tensor = self.bounds.normalise(disparity.detach()).clamp(*self._limits)
        return (normalised - focus).abs()

    def _whole(self, disparity: Tensor) -> Tensor:
        radius: Tensor = load("surface", function="circle")(
            disparity,
            self.slope,
            self.offset,
            low=self.bounds.q_min,
            extent=self.bounds.extent,
            scale=COC_FRACTION * self.camera.width,
            clipped=self._limits,
        )
        return radius

    @property
    def _limits(self) -> tuple[float, float]:
        return _CLIPPED if self.clipped else _FREE
