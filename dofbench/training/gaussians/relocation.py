"""Density control as sampling (Kheradmand et al., 3D Gaussian Splatting as Markov Chain Monte Carlo, NeurIPS 2024):
transparent Gaussians are moved to where opaque ones are, noise explores, and a cost keeps Gaussians few and small."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.runtime.device_numbers import beside
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians.density import DensityOptions, rotate
from dofbench.training.gaussians.density_pace import DensityPace
from dofbench.training.gaussians.model import PARAMETERS, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser

_MOST_COPIES = 51  # of one Gaussian at once; gsplat
_GROWTH = 0.05  # share by which the number of Gaussians grows each time
_STEEP = 100.0  # of the step in opacity, at prune_opacity, below which a Gaussian gets noise
_LEAST_OPACITY, _MOST_OPACITY = 1e-6, 1 - 1e-6


@dataclass(frozen=True)
class RelocationOptions:
    """How strongly density control by sampling explores, and what it charges."""

    mcmc: bool = False
    """Whether density is controlled by sampling instead of by gradients. Unit: none. Source: 3DGS-MCMC."""
    noise_lr: float = 5e5
    """Factor on the means' rate that gives the size of the noise on them. Unit: none. Source: 3DGS-MCMC."""
    opacity_cost: float = 0.01
    """Weight of the mean opacity in the loss. Unit: none. Source: 3DGS-MCMC."""
    scale_cost: float = 0.01
    """Weight of the mean scale in the loss. Unit: 1 / scene's extent. Source: 3DGS-MCMC, in scene units."""
    init_opacity: float = 0.5
    """Opacity of the first Gaussians. Unit: none. Source: 3DGS-MCMC."""
    init_scale: float = 0.1
    """Factor on the first Gaussians' scales. Unit: none. Source: 3DGS-MCMC."""


class Relocation:
    """Density control by sampling, with the interface of `DensityControl`. extent: of the scene, scene units."""

    def __init__(
        self,
        gaussians: Gaussians,
        optimiser: GaussianOptimiser,
        density: DensityOptions,
        options: RelocationOptions,
        extent: float,
        generator: torch.Generator,
    ):
        self._gaussians, self._optimiser, self._density, self._options = gaussians, optimiser, density, options
        self._extent, self._generator = extent, generator
        self.pace = DensityPace(density.densify_every)

    def cost(self) -> Tensor:
        """The term of the loss that charges opacity and scales."""
        parameters, options = self._gaussians.parameters, self._options
        opacity = torch.sigmoid(parameters["opacity_logits"]).mean()
        return (
            options.opacity_cost * opacity + options.scale_cost * parameters["log_scales"].exp().mean() / self._extent
        )

    def state(self) -> tuple[()]:
        """Nothing: no statistics are kept."""
        return ()

    def restore(self, state: tuple[()]) -> None:
        """Nothing."""

    def record(self, statistics: ViewStatistics, width: int, height: int) -> None:
        """Nothing: where Gaussians go doesn't depend on gradients."""

    def after_step(self, step: int, progress: float) -> bool:
        """Move and add Gaussians if it is due after step number `step`, at `progress`, and shake all; True when
        Gaussians were moved or added."""
        density = self._density
        changed = self.pace.due(step) and density.densify_from <= progress < density.densify_until
        if changed:
            self._move_transparent()
            self._add()
        self._shake()
        return changed

    @torch.no_grad()
    def _move_transparent(self) -> None:
        """Give transparent Gaussians the place of opaque ones, drawn by opacity, which share theirs with them."""
        opacity = torch.sigmoid(self._gaussians.parameters["opacity_logits"].detach())
        dead = torch.nonzero(opacity <= self._density.prune_opacity)[:, 0]
        alive = torch.nonzero(opacity > self._density.prune_opacity)[:, 0]
        if not len(dead) or not len(alive):
            return
        drawn = alive[self._drawn(opacity[alive], len(dead))]
        self._copy(drawn, dead)

    @torch.no_grad()
    def _add(self) -> None:
        """Add a share of the Gaussians, up to the limit, as copies drawn by opacity."""
        count = len(self._gaussians)
        more = min(self._density.max_gaussians, int((1 + _GROWTH) * count)) - count
        if more <= 0:
            return
        opacity = torch.sigmoid(self._gaussians.parameters["opacity_logits"].detach())
        drawn = self._drawn(opacity, more)
        kept = torch.arange(count, device=opacity.device)
        added = {name: self._gaussians.parameters[name].detach()[drawn].clone() for name in PARAMETERS}
        self._optimiser.rebuild(kept, added)
        self._copy(drawn, count + torch.arange(more, device=drawn.device))

    def _drawn(self, weights: Tensor, count: int) -> Tensor:
        """(count,) indices drawn in proportion to the weights, with replacement, by the host's generator."""
        host = weights.to(self._generator.device)
        found = torch.multinomial(host, count, replacement=True, generator=self._generator)
        return found.to(weights.device)

    def _copy(self, drawn: Tensor, places: Tensor) -> None:
        """Make the Gaussians in `places` copies of those drawn, and let each with its copies look as it did alone.
        Moments of both start again."""
        parameters = self._gaussians.parameters
        copies = torch.bincount(drawn, minlength=len(self._gaussians))[drawn] + 1
        opacity = torch.sigmoid(parameters["opacity_logits"].detach()[drawn])
        shared, smaller = shared_among(opacity, copies)
        parameters["opacity_logits"][drawn] = torch.logit(shared)
        parameters["log_scales"][drawn] += smaller.log()[:, None]
        for name in PARAMETERS:
            parameters[name][places] = parameters[name][drawn]
        self._optimiser.forget(torch.cat([drawn, places]))

    @torch.no_grad()
    def _shake(self) -> None:
        """Add noise with each transparent Gaussian's own covariance to its mean."""
        parameters = {name: value.detach() for name, value in self._gaussians.parameters.items()}
        # The generator is one of the host, so that a seed draws the same noise on every device.
        normal = torch.randn(parameters["means"].shape, generator=self._generator, device=self._generator.device)
        scales, quaternions = parameters["log_scales"].exp(), parameters["quaternions"]
        inverse = quaternions * beside(quaternions, [1.0, -1.0, -1.0, -1.0])
        noise = rotate(quaternions, scales.square() * rotate(inverse, normal.to(scales.device)))
        opacity = torch.sigmoid(parameters["opacity_logits"])
        transparent = torch.sigmoid(-_STEEP * (opacity - self._density.prune_opacity))
        strength = self._options.noise_lr * self._optimiser.means_rate
        parameters["means"] += strength * transparent[:, None] * noise


def shared_among(opacity: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """The opacity, and the factor on the scales, of so many copies of a Gaussian that together look as it does alone.

    opacity: (N,), and copies: (N,), at least 1. One behind the other they let as much light through, and the integral
    over the image is the same (3DGS-MCMC, Eq. 9). More than 51 copies count as 51.
    """
    count = copies.clamp(max=_MOST_COPIES)
    whole = opacity.double().clamp(_LEAST_OPACITY, _MOST_OPACITY)
    each = 1 - (1 - whole) ** (1 / count)
    integral = torch.zeros_like(whole)  # of the copies together, in units of the width of one
    for number in range(1, int(count.max()) + 1):
        term = sum(
            math.comb(number - 1, power) * (-1) ** power * each ** (power + 1) / math.sqrt(power + 1)
            for power in range(number)
        )
        integral += torch.where(count >= number, term, 0.0)
    return each.to(opacity.dtype), (whole / integral).to(opacity.dtype)
