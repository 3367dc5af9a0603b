"""DOF-GS (Wang et al., CVPR 2025): every Gaussian is enlarged by its CoC, and the sharp view is compared in focus.

Neither the paper's code nor its constants are public: the network that finds what is in focus (option `focus_network`)
and the weight of the second term of the loss are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.training.common.losses import without_held_out
from dofbench.training.common.networks import NetworkAdam, redraw
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import BlurOptions, BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import ForwardSchedule, OwnBlur

_WIDTH = 16  # channels of the network that finds what is in focus
_MASK_COST = 2e-3  # weight of the mean of what it says isn't in focus; that of gsplat's mask


@dataclass(frozen=True)
class FocusOptions:
    """The loss of the sharp view where a photograph is in focus."""

    in_focus_weight: float = 0.5
    """Weight of the mean absolute difference between the sharp view and the photograph in focus. Unit: none. Source:
    own."""
    in_focus_circle: float = 0.5
    """Radius of the circles of confusion up to which a pixel counts as in focus, without a network for it. Unit: px.
    Source: own."""
    focus_network: bool = False
    """Whether a network says which pixels are in focus, from circles of confusion and the photograph. Unit: none.
    Source: on: DOF-GS; off: own."""
    focus_network_lr: float = 1e-3
    """Adam's learning rate of that network. Unit: parameter, a step. Source: own."""

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
        focused = shot.circles(sharp.disparity.detach()) <= self._options.in_focus_circle
        return self.compared(sharp, view, focused)

    def compared(self, sharp: SharpView, view: ScaledView, focused: Tensor) -> Tensor:
        """The weighted mean difference of sharp view and photograph. focused: (H, W), how much each pixel counts."""
        difference = (without_held_out(sharp.raster.color, view.image, view.held_back) - view.image).abs().mean(dim=2)
        return self._options.in_focus_weight * (difference * focused * (sharp.raster.alpha > 0)).mean()


class LocalisedBlur(LearnedBlur):
    """As `FocusedBlur`, but a network finds which pixels are in focus.

    Its mask mixes the sharp and the blurred view; where the sharp one is as near to the photograph, a cost decides for
    it. The paper has such a network (DoF-Gaussian, section 2, names it); layers, inputs and its loss are ours.
    """

    reads = "depth"
    needs_sharp_render = True
    samples_aperture = True
    stage = "lens"

    def __init__(self, blur: BlurOptions, options: FocusOptions, generator: torch.Generator, device: torch.device):
        self._own = FocusedBlur(blur, options)
        self._network = nn.Sequential(
            nn.Conv2d(4, _WIDTH, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(_WIDTH, 1, 1),
        )
        redraw(self._network, generator)
        self._network.to(device)
        self._adam = NetworkAdam(self._network.named_parameters(), options.focus_network_lr, 1.0)
        self._blurred: Tensor | None = None

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Rasterise the blurred Gaussians."""
        image = self._own.render(scene, sharp, shot)
        self._blurred = image.detach()
        return image

    def mask(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor:
        """(H, W): how much the photograph just rendered is in focus, 0 to 1; the network alone gets a gradient.

        Held-out pixels have the rendered colour.
        """
        assert self._blurred is not None
        circles = shot.circles(sharp.disparity.detach()).log1p()
        seen = without_held_out(view.image, self._blurred, view.held_back)
        inputs = torch.cat([circles[..., None], seen], 2).permute(2, 0, 1)[None]
        return torch.sigmoid(self._network(inputs)[0, 0])

    def cost(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor:
        """The sharp view's weighted difference in focus, and the loss of the mask."""
        assert self._blurred is not None
        mask, color = self.mask(sharp, shot, view), sharp.raster.color.detach()
        mixed = mask[..., None] * color + (1 - mask[..., None]) * self._blurred
        difference = (without_held_out(mixed, view.image, view.held_back) - view.image).abs().mean()
        own = difference + _MASK_COST * (1 - mask).mean()
        return own + self._own.compared(sharp, view, mask.detach())

    def step(self, view: int, progress: float, cooldown: float) -> None:
        self._blurred = None
        self._adam.step(progress, cooldown)


@dataclass(frozen=True)
class FocusedOptions(GaussianOptions):
    """The trainer's options, and those of the loss in focus."""

    focus: FocusOptions = FocusOptions()

    def forward_models(self) -> ForwardSchedule:
        return ForwardSchedule([(0.0, FocusedBlur(self.blur, self.focus))])

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        if not self.focus.focus_network:
            return None
        return LocalisedBlur(self.blur, self.focus, start.generator, start.means.device)


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
