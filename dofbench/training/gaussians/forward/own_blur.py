"""Each Gaussian enlarged by its own circle of confusion, seen from the lens's centre (DOF-GS, CoCoGaussian).

As fast as the scatter, but a blurred foreground shows what lies behind it.
"""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.raster import Geometry
from dofbench.training.gaussians.forward.forward_model import BlurOptions, Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.lens_samples import views_from_lens
from dofbench.training.gaussians.forward.shot import Shot


class OwnBlur(WithoutCost):
    """A `ForwardModel` that rasterises a second time, with every Gaussian enlarged by the lens's blur."""

    reads: Geometry = "none"
    looks = False
    from_points = True
    stage = "lens"

    def __init__(self, blur: BlurOptions):
        self._blur = blur

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The scene of blurred Gaussians."""
        return views_from_lens(scene, shot, 0, self._blur.blur_to_depth)[0]
