"""DOF-GS (Wang et al., CVPR 2025): every Gaussian enlarged by its circle of confusion, and a second term of the loss,
which compares the sharp view with the photograph where that is in focus.

Neither the paper's code nor its constants are public: the limit of what counts as in focus and the weight of the term
are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.raster import Geometry
from dofbench.training.common.image_losses import looked_at
from dofbench.training.common.training_views import Photograph
from dofbench.training.gaussians.forward.forward_model import BlurOptions, SharpView
from dofbench.training.gaussians.forward.own_blur import OwnBlur
from dofbench.training.gaussians.forward.shot import Shot


@dataclass(frozen=True)
class FocusOptions:
    """The loss of the sharp view where a photograph is in focus."""

    in_focus_weight: float = 0.5
    """Weight of the mean absolute difference between the sharp view and the photograph in focus. Unit: none. Source:
    own."""
    in_focus_circle: float = 0.5
    """Radius of the circles of confusion up to which a pixel counts as in focus. Unit: px. Source: own."""

    def __post_init__(self) -> None:
        if self.in_focus_weight < 0:
            raise InputError("option in_focus_weight", str(self.in_focus_weight), "at least 0")


class FocusedBlur(OwnBlur):
    """A `ForwardModel` with the term of the loss for what is in focus."""

    reads: Geometry = "depth"
    looks = True

    def __init__(self, blur: BlurOptions, options: FocusOptions):
        super().__init__(blur)
        self._options = options

    def cost(self, sharp: SharpView, shot: Shot, view: Photograph) -> Tensor:
        """The weighted difference, over all pixels, of those in focus, without the photograph's learned colour. Neither
        the lens nor depth learns from which pixels these are."""
        focused = (shot.circles(sharp.disparity.detach()) <= self._options.in_focus_circle) & (sharp.raster.alpha > 0)
        difference = (looked_at(sharp.raster.color, view.image, view.held_back) - view.image).abs().mean(dim=2)
        return self._options.in_focus_weight * (difference * focused).mean()
