"""The paper's forward model (Algorithm 1): the pixels of the sharp view, each spread over its circle of confusion."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, ApertureShape, Energy
from dofbench.optics.defocus import defocus
from dofbench.runtime.raster import Geometry
from dofbench.training.gaussians.forward.forward_model import BlurOptions, Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.shot import Shot


@dataclass(frozen=True)
class ScatterOptions:
    """The shape and weight of the circle over which a pixel is spread."""

    lens_alpha: float = ALPHA
    """Steepness of the circle's rim, 1/2 + 1/2 tanh(alpha (R - l)). Unit: 1 / px. Source: Algorithm 1."""
    lens_energy: Energy = "area"
    """How a spread pixel is weighted: area, divided by its circle's area; algorithm1, not divided. Unit: none. Source:
    area: released code; algorithm1: Algorithm 1."""
    lens_blades: int = 0
    """Number of sides of a polygonal aperture; 0 for a disc. Unit: none. Source: own."""
    lens_rotation: float = 0.0
    """Rotation of the polygon. Unit: rad. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_blades < 0 or self.lens_blades in (1, 2):
            raise InputError("option lens_blades", str(self.lens_blades), "0, a disc, or at least 3")


class ScatterBlur(WithoutCost):
    """A `ForwardModel` that blurs the sharp view by the depth it was rendered with."""

    reads: Geometry = "depth"
    looks = True
    from_points = False
    stage = "lens"

    def __init__(self, blur: BlurOptions, options: ScatterOptions):
        shape = ApertureShape(options.lens_blades, options.lens_rotation)
        self._to_depth = blur.blur_to_depth
        self._spread = Blur(blur.lens_gamma, options.lens_alpha, shape, options.lens_energy)

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The sharp view scattered by its disparity."""
        disparity = sharp.disparity if self._to_depth else sharp.disparity.detach()
        return self.spread(sharp.raster.color, disparity, shot)

    def spread(self, colour: Tensor, disparity: Tensor, shot: Shot) -> Tensor:
        """A sharp image (H, W, 3), encoded, scattered by its disparity (H, W), 1 / scene unit."""
        return defocus(colour, shot.radius(disparity), self._spread)
