"""DOF-GS (Wang et al., CVPR 2025): every Gaussian is enlarged by its CoC, and the sharp view is compared in focus.

Neither the paper's code nor its constants are public: the limit of what counts as in focus and the weight of the second
term of the loss are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.training.common.losses import without_held_out
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import BlurOptions, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import ForwardSchedule, OwnBlur


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
    """Each Gaussian's own blur, with a term of the loss for the pixels in focus."""

    reads = "depth"
    needs_sharp_render = True

    def __init__(self, blur: BlurOptions, options: FocusOptions):
        super().__init__(blur)
        self._options = options

    def cost(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor:
        """The weighted mean difference over all pixels, of those in focus, without the view's learned colour.

        Neither the lens nor depth learns from which pixels these are.
        """
        focused = (shot.circles(sharp.disparity.detach()) <= self._options.in_focus_circle) & (sharp.raster.alpha > 0)
        difference = (without_held_out(sharp.raster.color, view.image, view.held_back) - view.image).abs().mean(dim=2)
        return self._options.in_focus_weight * (difference * focused).mean()


@dataclass(frozen=True)
class FocusedOptions(GaussianOptions):
    """The trainer's options, and those of the loss in focus."""

    focus: FocusOptions = FocusOptions()

    def forward_models(self) -> ForwardSchedule:
        return ForwardSchedule([(0.0, FocusedBlur(self.blur, self.focus))])


class DOFGS(GaussianMethod):
    """A learned lens per view; each Gaussian is enlarged by its CoC, in all of the training and in rendering."""

    OPTIONS = FocusedOptions
    # Trials compare forward models, of which this method has one.
    FORCED: ClassVar[Mapping[str, Any]] = {
        "lens": True,
        "lens_model": "samples",
        "lens_rings": 0,
        "lens_trials": "",
        "adaptation": "off",
    }
