"""gsplat's defocus module (pull request 469): Gaussians enlarged by a network as in Deblurring 3D Gaussian Splatting,
and a second network that says for each pixel how much of the blurred view and how much of the sharp one it shows.

By itself the enlarging network also blurs what a photograph shows sharp, and the scene becomes too sharp to make up for
it; the mask lets the sharp view learn from what is in focus. What the pull request says of itself is followed; the
mask's inputs, of which it says little, are the photograph, the rendered disparity and the place in the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.runtime.raster import Geometry
from dofbench.training.common.networks import NetworkAdam, encoded_places, in_a_row, rectified, redraw
from dofbench.training.common.training_views import Photograph
from dofbench.training.gaussians.forward.enlarged_gaussians import EnlargedGaussians
from dofbench.training.gaussians.forward.forward_model import ForwardModel, Rasteriser, SharpView
from dofbench.training.gaussians.forward.shot import Shot

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


class MaskedBlur:
    """A `ForwardModel` and `LearnedBlur`."""

    reads: Geometry = "depth"
    looks = True
    from_points = False
    stage = "blur"
    kernels: tuple[str, ...] = ()

    def __init__(
        self,
        enlarged: EnlargedGaussians,
        views: int,
        options: MaskOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._enlarged, self._options = enlarged, options
        self._network = _MaskNetwork(views, generator).to(device)
        self._adam = NetworkAdam(self._network.named_parameters(), options.mask_lr, 1.0)
        self._mask: Tensor | None = None

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """As the enlarged Gaussians begin."""
        return [*self._enlarged.models()[:-1], (self._enlarged.models()[-1][0], self)]

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The blurred and the sharp view, mixed by the mask."""
        blurred = self._enlarged.photograph(scene, sharp, shot)
        self._mask = self.mask(sharp, shot)[..., None]
        return self._mask * blurred + (1 - self._mask) * sharp.raster.color

    def mask(self, sharp: SharpView, shot: Shot) -> Tensor:
        """(H, W): how much of the blurred view a photograph shows, 0 to 1."""
        assert shot.number is not None
        depth = shot.bounds.normalise(sharp.disparity.detach()).clamp(0, 1)
        height, width = depth.shape
        down, across = (torch.linspace(-1, 1, count, device=depth.device) for count in (height, width))
        rows, columns = torch.meshgrid(down, across, indexing="ij")
        pixels = torch.stack([depth, columns, rows], 2).reshape(-1, 3)
        return self._network(shot.number, pixels).view(height, width)

    def cost(self, sharp: SharpView, shot: Shot, view: Photograph) -> Tensor | None:
        """The weighted mean of the mask of the photograph just made."""
        assert self._mask is not None
        return self._options.mask_cost * self._mask.mean()

    def gradient(self) -> Tensor | None:
        """Those by both networks' parameters."""
        return in_a_row([self._adam.gradient(), self._enlarged.gradient()])

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """An Adam step on both networks."""
        self._adam.step(progress, cooldown)
        self._enlarged.step(view, progress, cooldown)


class _MaskNetwork(nn.Module):
    """From a photograph, a pixel's disparity and its place to the mask."""

    def __init__(self, views: int, generator: torch.Generator):
        super().__init__()
        self.embedding = nn.Parameter(torch.randn(views, _EMBEDDING, generator=generator, device=generator.device))
        own = (1 + 2 * _DEPTH_FREQUENCIES) + 2 * (1 + 2 * _PLACE_FREQUENCIES)
        # The photograph is the same for all pixels, so its part of the first layer is computed once.
        self.first, self.photograph = nn.Linear(own, _WIDTH), nn.Linear(_EMBEDDING, _WIDTH, bias=False)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise([_WIDTH] * _HIDDEN))
        self.head = nn.Linear(_WIDTH, 1)
        redraw(self, generator)

    def forward(self, number: int, pixels: Tensor) -> Tensor:
        """(P,) from 0 to 1. pixels: (P, 3), disparity from 0 to 1, and column and row from -1 to 1."""
        inputs = torch.cat(
            [
                encoded_places(pixels[:, :1] * math.pi, _DEPTH_FREQUENCIES),
                encoded_places(pixels[:, 1:] * math.pi, _PLACE_FREQUENCIES),
            ],
            1,
        )
        features = rectified(self.first, inputs, self.photograph(self.embedding[number]))
        for layer in self.hidden:
            features = rectified(layer, features)
        return torch.sigmoid(self.head(features)[:, 0])
