"""CoCoGaussian (Lee et al., CVPR 2025): a view is mixed from the scene and from copies of it, whose Gaussians a network
moves and enlarges in proportion to their CoC.

The CoC is |1 / distance - 1 / focus|, with a focus learned for each view. There is no aperture; the network's outputs
stand for it. The published code creates the foci late, and learns them only once its optimiser is rebuilt; here they
are learned from the start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.runtime.device_numbers import beside
from dofbench.training.common.networks import NetworkAdam, in_a_row, redraw
from dofbench.training.common.row_adam import RowAdam
from dofbench.training.gaussians.blur_network import GaussianNetwork
from dofbench.training.gaussians.extra_points import GrownOnceOptions
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import LenslessMethod

_MOST = 1.1  # the largest factor
_BELOW = 0.01  # how far below e, whose logarithm is the least factor, an output of 0 is


@dataclass(frozen=True)
class CopiesOptions:
    """How the copies of the scene are learned."""

    copies: int = 4
    """Copies beside the scene itself; each costs a rasterisation. Unit: none. Source: CoCoGaussian."""
    copies_from: float = 0.05
    """When they begin; before that the photograph is the sharp view. Unit: share of the training. Source: CoCoGaussian,
    step 1500 of 30 000."""
    copies_lr: float = 1e-3
    """Adam's learning rate of the networks at the start. Unit: parameter, a step. Source: CoCoGaussian."""
    copies_lr_final: float = 0.01
    """Share of it that is left at the end; it falls exponentially. Unit: none. Source: CoCoGaussian."""
    focus_lr: float = 1e-2
    """Adam's learning rate of the logarithms of the focuses. Unit: logarithm, a step. Source: own."""
    mixing: Literal["together", "each"] = "together"
    """What gives the weights by which scene and copies are mixed: together, a network that looks at all their views at
    once; each, a network that looks at each view by itself, with instance normalisation. Unit: none. Source: each:
    CoCoGaussian; together: own."""
    mixing_width: int = 16
    """Channels of that network. Unit: none. Source: own; 64 in CoCoGaussian."""

    def __post_init__(self) -> None:
        if self.mixing_width < 1:
            raise InputError("option mixing_width", str(self.mixing_width), "at least 1")


class CircleCopies(LearnedBlur):
    """Mixes the scene and its copies. first: (V,) distances of focus at the start, scene units. origin, unit: see
    `GaussianNetwork`."""

    needs_sharp_render = False

    def __init__(self, first: Tensor, origin: Tensor, unit: float, options: CopiesOptions, generator: torch.Generator):
        self._first, self._unit, self._options, self.begins = first, unit, options, options.copies_from
        count = options.copies
        # As for enlarged Gaussians, outputs begin where most factors are above the least and have a gradient.
        self._network = GaussianNetwork((3 * count, 7 * (count + 1)), (0.0, 1.0), origin, unit, generator)
        self._mixing = mixing_network(options, generator).to(first.device)
        parameters = [
            (f"{part}.{name}", parameter)
            for part, network in (("copies", self._network), ("mixing", self._mixing))
            for name, parameter in network.named_parameters()
        ]
        self._adam = NetworkAdam(parameters, options.copies_lr, options.copies_lr_final)
        self._focuses = RowAdam(first.new_zeros(len(first), 1))

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Mix the scene and its copies pixel by pixel."""
        copies = self.copies(scene.gaussians.parameters, shot)
        views = torch.stack([scene.rasterise_with(shot.camera, changes) for changes in copies])
        images = views.detach().permute(0, 3, 1, 2)
        if self._options.mixing == "together":
            images = images.reshape(1, -1, *images.shape[2:])
        logits = self._mixing(images).view(views.shape[:3])
        return (torch.softmax(logits, 0)[..., None] * views).sum(0)

    def copies(self, parameters: dict[str, Tensor], shot: Shot) -> list[dict[str, Tensor]]:
        """The changed parameters of the scene itself, whose means stay, and of each copy."""
        moves, growths = self._network(parameters, shot.camera)
        circle = self.circles(parameters["means"], shot)[:, None]
        changed = []
        for number in range(self._options.copies + 1):
            grown = circle * growths[:, 7 * number : 7 * (number + 1)] + math.e - _BELOW
            factor = grown.clamp(math.e, math.e**_MOST).log()
            one = {
                "log_scales": parameters["log_scales"] + factor[:, :3].log(),
                "quaternions": parameters["quaternions"] * factor[:, 3:],
            }
            if number:
                move = moves[:, 3 * (number - 1) : 3 * number]
                one["means"] = parameters["means"] + self._unit * circle * move
            changed.append(one)
        return changed

    def circles(self, means: Tensor, shot: Shot) -> Tensor:
        """(N,) |1 / distance - 1 / focus|, times the network's unit, at means (N, 3); the focus alone gets a
        gradient."""
        assert shot.number is not None
        distance = (means.detach() - beside(means, shot.camera.centre)).norm(dim=1)
        focus = self._first[shot.number] * self._focuses.leaf(shot.number).exp()
        return self._unit * (1 / distance - 1 / focus).abs()

    def focuses(self) -> Tensor:
        """(V,) distances of focus, scene units."""
        return self._first * self._focuses.values[:, 0].exp()

    def gradient(self) -> Tensor | None:
        return in_a_row([self._adam.gradient(), self._focuses.gradient])

    def step(self, view: int, progress: float, cooldown: float) -> None:
        self._adam.step(progress, cooldown)
        self._focuses.step(view, self._options.focus_lr * cooldown)


def mixing_network(options: CopiesOptions, generator: torch.Generator) -> nn.Module:
    """The network from views to the logits of their weights: for `together` from all views as channels of one image,
    with equal weights at first; for `each` from a batch of views."""
    count, width = options.copies + 1, options.mixing_width
    if options.mixing == "each":
        network = nn.Sequential(
            nn.Conv2d(3, width, 5, padding=2),
            nn.ReLU(),
            nn.InstanceNorm2d(width),
            nn.Conv2d(width, width, 3, padding=1),
            nn.ReLU(),
            nn.InstanceNorm2d(width),
            nn.Conv2d(width, 1, 3, padding=1, bias=False),
        )
        redraw(network, generator)
        return network
    last = nn.Conv2d(width, count, 3, padding=1)
    network = nn.Sequential(nn.Conv2d(3 * count, width, 3, padding=1), nn.ReLU(), last)
    redraw(network, generator)
    with torch.no_grad():
        for parameter in last.parameters():
            parameter.zero_()
    return network


@dataclass(frozen=True)
class CopiedOptions(GrownOnceOptions):
    """Options of the trainer, of added points, and of the copies."""

    copies: CopiesOptions = CopiesOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur:
        """Copies, with every view first focused at the mean distance of the Gaussians."""
        centres = beside(start.means, [camera.centre for camera in start.cameras])
        first = torch.stack([(start.means - centre).norm(dim=1).mean() for centre in centres])
        return CircleCopies(first, start.centre, start.extent, self.copies, start.generator)


class CoCoGaussian(LenslessMethod):
    """Gaussians without a lens; in training, views are mixed from the scene and copies of it."""

    OPTIONS = CopiedOptions
