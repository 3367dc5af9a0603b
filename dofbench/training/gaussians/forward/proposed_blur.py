"""BAGS (Peng et al., ECCV 2024): a network proposes for every pixel of a photograph the weights of its neighbours, and
how much of the picture so mixed is seen and how much of the sharp one.

It works on the finished picture, with larger kernels the finer the scale that is trained on. Its widths are smaller
than the published ones, which would take most of a training on a processor (option `proposal_width`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.runtime.ops import load
from dofbench.runtime.raster import Geometry
from dofbench.training.common.networks import NetworkAdam, rectified, redraw
from dofbench.training.common.training_views import Photograph
from dofbench.training.gaussians.forward.forward_model import ForwardModel, Rasteriser, SharpView
from dofbench.training.gaussians.forward.pinhole import Pinhole
from dofbench.training.gaussians.forward.shot import Shot

_SIZES = {4: 5, 2: 9, 1: 17}  # kernels by how many times smaller than the photographs the pictures are
_EMBEDDING, _FEATURES, _WAVES, _WIDTH = 32, 32, 4, 64


@dataclass(frozen=True)
class ProposalOptions:
    """How the network that proposes blur is learned."""

    proposal_from: float = 0.008
    """When the blur begins; before that the photograph is the sharp view. Unit: share of the training. Source: BAGS,
    step 250 of about 30 000."""
    proposal_width: int = 16
    """Channels of the network's first two layers, over the sharp view and its depth. Unit: none. Source: own; 64 in
    BAGS."""
    proposal_lr: float = 5e-4
    """Adam's learning rate of the network. Unit: parameter, a step. Source: BAGS."""
    proposal_cost: float = 1e-3
    """Weight of the mean of the mask in the loss. Unit: none. Source: BAGS."""

    def __post_init__(self) -> None:
        if self.proposal_width < 1:
            raise InputError("option proposal_width", str(self.proposal_width), "at least 1")


class ProposedBlur:
    """A `ForwardModel` and `LearnedBlur`. widths: of the photographs at full size, pixels."""

    reads: Geometry = "depth"
    looks = True
    from_points = False
    stage = "blur"
    kernels: tuple[str, ...] = ("mix",)

    def __init__(
        self,
        widths: Sequence[int],
        options: ProposalOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._widths, self._options = tuple(widths), options
        self._network = _ProposalNetwork(len(widths), options.proposal_width, generator).to(device)
        self._adam = NetworkAdam(self._network.named_parameters(), options.proposal_lr, 1.0)
        self._mask: Tensor | None = None

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """The sharp view, then this model."""
        return [(0.0, Pinhole()), (self._options.proposal_from, self)]

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The sharp view and its mixture, mixed by the mask."""
        assert shot.number is not None and sharp.raster.depth is not None
        scale = self._widths[shot.number] / shot.camera.width
        nearest = min(_SIZES, key=lambda factor: abs(math.log(factor / scale)))
        color, depth = sharp.raster.color, sharp.raster.depth.detach()
        logits, mask = self._network(shot.number, color.detach(), depth, nearest)
        mixed: Tensor = load("mix")(color, logits)
        self._mask = mask[..., None]
        return self._mask * mixed + (1 - self._mask) * color

    def cost(self, sharp: SharpView, shot: Shot, view: Photograph) -> Tensor | None:
        """The weighted mean of the mask of the photograph just made."""
        assert self._mask is not None
        return self._options.proposal_cost * self._mask.mean()

    def gradient(self) -> Tensor | None:
        """Those by the network's parameters."""
        return self._adam.gradient()

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """An Adam step on the network."""
        self._mask = None
        self._adam.step(progress, cooldown)


class _ProposalNetwork(nn.Module):
    """From a photograph's number, the sharp view and its depth to logits of the neighbours and a mask."""

    def __init__(self, views: int, width: int, generator: torch.Generator):
        super().__init__()
        self.embedding = nn.Parameter(torch.randn(views, _EMBEDDING, generator=generator, device=generator.device))
        self.picture = nn.Sequential(
            nn.Conv2d(4, width, 5, padding=2),
            nn.ReLU(),
            nn.InstanceNorm2d(width),
            nn.Conv2d(width, width, 5, padding=2),
            nn.ReLU(),
            nn.InstanceNorm2d(width),
            nn.Conv2d(width, _FEATURES, 3, padding=1),
        )
        # Layers that see a pixel alone. The photograph is the same for all pixels, so its part is computed once.
        self.base = nn.Linear(4 * _WAVES + _FEATURES, _WIDTH, bias=False)
        self.photograph = nn.Linear(_EMBEDDING, _WIDTH, bias=False)
        self.deeper = nn.ModuleList(nn.Linear(_WIDTH, _WIDTH, bias=False) for _ in range(len(_SIZES) - 1))
        self.heads = nn.ModuleDict(
            {str(factor): nn.Linear(_WIDTH, size * size + 1, bias=False) for factor, size in _SIZES.items()}
        )
        redraw(self, generator)

    def forward(self, number: int, color: Tensor, depth: Tensor, factor: int) -> tuple[Tensor, Tensor]:
        """(logits (H, W, K * K), mask (H, W) from 0 to 1) for a picture so many times smaller than the photographs.
        color: (H, W, 3). depth: (H, W), any unit."""
        height, width = depth.shape
        nearest, farthest = depth.min(), depth.max()
        normalised = (depth - nearest) / (farthest - nearest).clamp_min(1e-12)
        picture = torch.cat([color, normalised[..., None]], 2).permute(2, 0, 1)[None]
        features = self.picture(picture)[0].flatten(1).T
        inputs = torch.cat([_waves(height, width, depth.device), features], 1)
        hidden = rectified(self.base, inputs, self.photograph(self.embedding[number]))
        for layer in self.deeper[: list(_SIZES).index(factor)]:
            hidden = rectified(layer, hidden)
        # Two products, since to take one's last column away would copy all the others, the largest thing in a step.
        head = self.heads[str(factor)]
        assert isinstance(head, nn.Linear)
        of_logits, of_mask = head.weight[:-1], head.weight[-1]
        logits, mask = hidden @ of_logits.T, torch.sigmoid(hidden @ of_mask)
        return logits.view(height, width, -1), mask.view(height, width)


def _waves(height: int, width: int, device: torch.device) -> Tensor:
    """(H * W, 4 waves): sines and cosines of a pixel's row and column."""
    down, across = (torch.linspace(0, 1, count, device=device) for count in (height, width))
    rows, columns = torch.meshgrid(down, across, indexing="ij")
    places = torch.stack([rows, columns], 2).reshape(-1, 2) * math.pi
    angles = torch.cat([places * 2.0**k for k in range(_WAVES)], 1)
    return torch.cat([angles.sin(), angles.cos()], 1)
