"""BAGS (Peng et al., ECCV 2024): a network proposes for every pixel the weights of its neighbours, and a mask that
mixes the result with the sharp view. Training goes from coarse to fine in three scales.

The network works on the rendered image, with larger kernels at finer scales. Its widths are smaller than the published
ones, which would take most of a training on a processor (option `proposal_width`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.runtime.ops import load
from dofbench.training.common.networks import NetworkAdam, rectified, redraw
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import LenslessMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions, ScheduleOptions

_SIZES = {4: 5, 2: 9, 1: 17}  # width of the kernel by how many times the images are smaller than the views
_EMBEDDING, _FEATURES, _WAVES, _WIDTH = 32, 32, 4, 64


@dataclass(frozen=True)
class ThreeScales(ScheduleOptions):
    """A schedule that begins with photographs of a quarter of their size."""

    quarter_until: float = 0.1
    """Train on photographs of a quarter of their size up to here, and on those of half their size up to coarse_until.
    Unit: share of the training. Source: BAGS, step 3000 of about 30 000."""
    coarse_until: float = 0.2
    """Train on shrunk photographs up to this share of the training. Unit: share of the training. Source: BAGS, step
    6000."""
    restart_at: float = 0.0
    """When the rate of the means begins again at its start, at the last scale; 0 for never. Unit: share of the
    training. Source: BAGS, step 6000 to 18 000 of 10 000 to 58 000, scene by scene."""

    def __post_init__(self) -> None:
        if not 0 <= self.restart_at < 1:
            raise InputError("option restart_at", str(self.restart_at), "a share of 0 to below 1")

    def rate_progress(self, progress: float) -> float:
        return progress if progress < self.restart_at else (progress - self.restart_at) / (1 - self.restart_at)

    @property
    def sizes(self) -> tuple[int, ...]:
        """1, 2 and 4, except scales that last no time."""
        lasting = {1: 1.0, 2: self.coarse_until - self.quarter_until, 4: self.quarter_until}
        return tuple(factor for factor, time in lasting.items() if time > 0)

    def size(self, progress: float) -> int:
        return 4 if progress < self.quarter_until else 2 if progress < self.coarse_until else 1


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
    depth_variation: float = 0.0
    """Weight in the loss of the variation of the sharp view's depth, which is scaled to 0 to 1. Unit: none. Source:
    BAGS, 1e-3 or 1e-2 in six of its ten scenes; 0: own."""
    colour_variation: float = 0.0
    """Weight in the loss of the variation of the sharp view. Unit: none. Source: BAGS, 1e-3 or 1e-2 in four of its ten
    scenes; 0: own."""

    def __post_init__(self) -> None:
        if self.proposal_width < 1:
            raise InputError("option proposal_width", str(self.proposal_width), "at least 1")
        for name in ("depth_variation", "colour_variation"):
            if getattr(self, name) < 0:
                raise InputError(f"option {name}", str(getattr(self, name)), "at least 0")


class ProposedBlur(LearnedBlur):
    """Mixes neighbouring pixels by the network's weights. widths: of the views at full size, px."""

    reads = "depth"
    kernels = ("mix",)

    def __init__(
        self,
        widths: Sequence[int],
        options: ProposalOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._widths, self._options, self.begins = tuple(widths), options, options.proposal_from
        self._network = _ProposalNetwork(len(widths), options.proposal_width, generator).to(device)
        self._adam = NetworkAdam(self._network.named_parameters(), options.proposal_lr, 1.0)
        self._mask: Tensor | None = None

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Mix the sharp view with its neighbours' mixture by the mask."""
        assert shot.number is not None and sharp.raster.depth is not None
        scale = self._widths[shot.number] / shot.camera.width
        nearest = min(_SIZES, key=lambda factor: abs(math.log(factor / scale)))
        color, depth = sharp.raster.color, sharp.raster.depth.detach()
        logits, mask = self._network(shot.number, color.detach(), depth, nearest)
        mixed: Tensor = load("mix")(color, logits)
        self._mask = mask[..., None]
        return self._mask * mixed + (1 - self._mask) * color

    def cost(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor:
        """The weighted mean of the last mask, and the weighted variations of the sharp view and of its depth."""
        assert self._mask is not None and sharp.raster.depth is not None
        options = self._options
        cost = options.proposal_cost * self._mask.mean()
        if options.depth_variation > 0:
            cost = cost + options.depth_variation * variation(_normalised(sharp.raster.depth)[..., None])
        if options.colour_variation > 0:
            cost = cost + options.colour_variation * variation(sharp.raster.color)
        return cost

    def step(self, view: int, progress: float, cooldown: float) -> None:
        self._mask = None
        self._adam.step(progress, cooldown)


class _ProposalNetwork(nn.Module):
    """From a view's number, the sharp view and its depth to logits of the neighbours and a mask."""

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
        # Layers on single pixels. The view's part is the same for all pixels, so it is computed once.
        self.base = nn.Linear(4 * _WAVES + _FEATURES, _WIDTH, bias=False)
        self.photograph = nn.Linear(_EMBEDDING, _WIDTH, bias=False)
        self.deeper = nn.ModuleList(nn.Linear(_WIDTH, _WIDTH, bias=False) for _ in range(len(_SIZES) - 1))
        self.heads = nn.ModuleDict(
            {str(factor): nn.Linear(_WIDTH, size * size + 1, bias=False) for factor, size in _SIZES.items()}
        )
        redraw(self, generator)

    def forward(self, number: int, color: Tensor, depth: Tensor, factor: int) -> tuple[Tensor, Tensor]:
        """(logits (H, W, K * K), mask (H, W) from 0 to 1) of an image `factor` times smaller than the views.

        color: (H, W, 3). depth: (H, W), any unit.
        """
        height, width = depth.shape
        picture = torch.cat([color, _normalised(depth)[..., None]], 2).permute(2, 0, 1)[None]
        features = self.picture(picture)[0].flatten(1).T
        inputs = torch.cat([_waves(height, width, depth.device), features], 1)
        hidden = rectified(self.base, inputs, self.photograph(self.embedding[number]))
        for layer in self.deeper[: list(_SIZES).index(factor)]:
            hidden = rectified(layer, hidden)
        # Two products: taking the last column of one would copy all others, the largest tensor of a step.
        head = self.heads[str(factor)]
        assert isinstance(head, nn.Linear)
        of_logits, of_mask = head.weight[:-1], head.weight[-1]
        logits, mask = hidden @ of_logits.T, torch.sigmoid(hidden @ of_mask)
        return logits.view(height, width, -1), mask.view(height, width)


def variation(image: Tensor) -> Tensor:
    """Twice the mean squared difference of vertical and of horizontal neighbours in an image (H, W, C), summed."""
    down, across = image[1:] - image[:-1], image[:, 1:] - image[:, :-1]
    return 2 * (down.square().mean() + across.square().mean())


def _normalised(depth: Tensor) -> Tensor:
    """(H, W): depth scaled to 0 at its least value and 1 at its largest."""
    nearest, farthest = depth.min(), depth.max()
    return (depth - nearest) / (farthest - nearest).clamp_min(1e-12)


def _waves(height: int, width: int, device: torch.device) -> Tensor:
    """(H * W, 4 waves): sines and cosines of a pixel's row and column."""
    down, across = (torch.linspace(0, 1, count, device=device) for count in (height, width))
    rows, columns = torch.meshgrid(down, across, indexing="ij")
    places = torch.stack([rows, columns], 2).reshape(-1, 2) * math.pi
    angles = torch.cat([places * 2.0**k for k in range(_WAVES)], 1)
    return torch.cat([angles.sin(), angles.cos()], 1)


@dataclass(frozen=True)
class ProposedOptions(GaussianOptions):
    """The trainer's options, on three scales, and those of the network."""

    schedule: ThreeScales = ThreeScales()
    proposal: ProposalOptions = ProposalOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur:
        widths = [camera.width for camera in start.cameras]
        return ProposedBlur(widths, self.proposal, start.generator, start.means.device)


class BAGS(LenslessMethod):
    """Gaussians without a lens; in training, a network proposes a blur kernel and a mask for every pixel."""

    OPTIONS = ProposedOptions
    FORCED: ClassVar[Mapping[str, Any]] = {**LenslessMethod.FORCED, "coarse_factor": 2}
