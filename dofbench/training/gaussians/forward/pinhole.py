"""No lens: all is in focus."""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.raster import Geometry
from dofbench.training.gaussians.forward.forward_model import Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.shot import Shot


class Pinhole(WithoutCost):
    """A `ForwardModel` whose photograph is the sharp view."""

    reads: Geometry = "none"
    looks = True
    from_points = False
    stage = "rasterise"

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The sharp view's colours, whatever lens the shot has."""
        return sharp.raster.color
