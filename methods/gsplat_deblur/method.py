"""gsplat's defocus module (pull request 469): Gaussians enlarged by a network as in Deblurring 3D Gaussian Splatting,
and a second network that mixes the blurred and the sharp view in each pixel.

By itself the enlarging network also blurs what is in focus, and the scene becomes too sharp to make up for it. With the
mask the sharp view learns from what is in focus. The pull request says little of the mask's inputs: here they are the
view's number, the rendered disparity and the pixel's place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.methods.deblurring3dgs.method import EnlargedGaussians, EnlargedOptions
from dofbench.training.common.networks import NetworkAdam, encoded_places, in_a_row, rectified, redraw
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import LenslessMethod

_EMBEDDING, _WIDTH, _HIDDEN = 4, 64, 4
_DEPTH_FREQUENCIES, _PLACE_FREQUENCIES = 3, 1


@dataclass(frozen=True)
class MaskOptions:
    """How the mask between blurred and sharp view is learned."""

    mask_lr: float = 1e-3
    """Adam's learning rate of the mask's network. Unit: parameter, a step. Source: gsplat pull request 469."""
    mask_cost: float = 0.002
    """Weight of the mask's mean in the loss, so that a pixel is taken from the sharp view where that will do. Unit:
    none. Source: gsplat pull request 469."""


class MaskedBlur(LearnedBlur):
    """Mixes the view of enlarged Gaussians with the sharp view by a learned mask."""

    reads = "depth"

    def __init__(
        self,
        enlarged: EnlargedGaussians,
        views: int,
        options: MaskOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._enlarged, self._options, self.begins = enlarged, options, enlarged.begins
        self._network = _MaskNetwork(views, generator).to(device)
        self._adam = NetworkAdam(self._network.named_parameters(), options.mask_lr, 1.0)
        self._mask: Tensor | None = None

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Mix the blurred and the sharp view by the mask."""
        blurred = self._enlarged.render(scene, sharp, shot)
        self._mask = self.mask(sharp, shot)[..., None]
        return self._mask * blurred + (1 - self._mask) * sharp.raster.color

    def mask(self, sharp: SharpView, shot: Shot) -> Tensor:
        """(H, W): the share of the blurred view, 0 to 1."""
        assert shot.number is not None
        depth = shot.bounds.normalise(sharp.disparity.detach()).clamp(0, 1)
        height, width = depth.shape
        down, across = (torch.linspace(-1, 1, count, device=depth.device) for count in (height, width))
        rows, columns = torch.meshgrid(down, across, indexing="ij")
        pixels = torch.stack([depth, columns, rows], 2).reshape(-1, 3)
        return self._network(shot.number, pixels).view(height, width)

    def cost(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor:
        """The weighted mean of the last mask."""
        assert self._mask is not None
        return self._options.mask_cost * self._mask.mean()

    def gradient(self) -> Tensor | None:
        return in_a_row([self._adam.gradient(), self._enlarged.gradient()])

    def step(self, view: int, progress: float, cooldown: float) -> None:
        self._mask = None  # with the graph behind it, of which a snapshot can't have a copy
        self._adam.step(progress, cooldown)
        self._enlarged.step(view, progress, cooldown)


class _MaskNetwork(nn.Module):
    """From a view's number, a pixel's disparity and its place to the mask."""

    def __init__(self, views: int, generator: torch.Generator):
        super().__init__()
        self.embedding = nn.Parameter(torch.randn(views, _EMBEDDING, generator=generator, device=generator.device))
        own = (1 + 2 * _DEPTH_FREQUENCIES) + 2 * (1 + 2 * _PLACE_FREQUENCIES)
        # The view's part of the first layer is the same for all pixels, so it is computed once.
        self.first, self.photograph = nn.Linear(own, _WIDTH), nn.Linear(_EMBEDDING, _WIDTH, bias=False)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise([_WIDTH] * _HIDDEN))
        self.head = nn.Linear(_WIDTH, 1)
        redraw(self, generator)

    def forward(self, number: int, pixels: Tensor) -> Tensor:
        """(P,) from 0 to 1. pixels: (P, 3), disparity from 0 to 1, and column and row from -1 to 1."""
        depth, places = pixels[:, :1] * math.pi, pixels[:, 1:] * math.pi
        inputs = [encoded_places(depth, _DEPTH_FREQUENCIES), encoded_places(places, _PLACE_FREQUENCIES)]
        features = rectified(self.first, torch.cat(inputs, 1), self.photograph(self.embedding[number]))
        for layer in self.hidden:
            features = rectified(layer, features)
        return torch.sigmoid(self.head(features)[:, 0])


@dataclass(frozen=True)
class MaskedOptions(EnlargedOptions):
    """Options of Deblurring 3D Gaussian Splatting, and of the mask."""

    mask: MaskOptions = MaskOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur:
        enlarged = self.enlarged(start)
        return MaskedBlur(enlarged, len(start.cameras), self.mask, start.generator, start.means.device)


class MaskedDeblurring(LenslessMethod):
    """Gaussians without a lens; in training, enlarged and sharp ones are mixed by a mask."""

    OPTIONS = MaskedOptions
