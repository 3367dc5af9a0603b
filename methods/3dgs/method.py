"""3D Gaussian Splatting (Kerbl et al., SIGGRAPH 2023), and density control by sampling (option `mcmc`; Kheradmand et
al., 3D Gaussian Splatting as Markov Chain Monte Carlo, NeurIPS 2024)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from dofbench.core.contracts import PointCloud
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians.density import DensityControl, DensityOptions, rotate
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import PARAMETERS, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser
from dofbench.training.gaussians.render import AppearanceOptions

_MOST_COPIES = 51  # of one Gaussian at once; gsplat
_GROWTH = 0.05  # share by which the number of Gaussians grows each time
_STEEP = 100.0  # of the step in opacity, at prune_opacity, below which a Gaussian gets noise
_LEAST_OPACITY, _MOST_OPACITY = 1e-6, 1 - 1e-6


@dataclass(frozen=True)
class DilatedAppearance(AppearanceOptions):
    """Footprints dilated by 0.3 px^2 without lowering opacities, and no 3D filter."""

    filter_2d: float = 0.3
    """Dilation: variance that is added to every footprint, which keeps its opacity. Unit: px^2. Source: 3DGS."""
    filter_3d: bool = False
    """Whether Gaussians are at least as large as their finest sampling. Unit: none. Source: Mip-Splatting; off in
    3DGS."""

    @property
    def filter_2d_fades(self) -> bool:
        return False


@dataclass(frozen=True)
class PrunedDensity(DensityOptions):
    """Large Gaussians are removed, too."""

    prune_scale: float = 0.1
    """Scale above which a Gaussian is removed, after the first reset of opacities. Unit: share of the scene's extent.
    Source: 3DGS."""

    @property
    def largest_kept(self) -> float:
        return self.prune_scale


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


class Relocation(DensityControl):
    """Density control by sampling: transparent Gaussians move to opaque ones, noise explores, and a cost keeps
    Gaussians few and small. extent: of the scene, scene units."""

    def __init__(
        self,
        gaussians: Gaussians,
        optimiser: GaussianOptimiser,
        density: DensityOptions,
        options: RelocationOptions,
        extent: float,
        generator: torch.Generator,
    ):
        super().__init__(gaussians, optimiser, density, extent, generator)
        self._density, self._relocation = density, options

    def cost(self) -> Tensor:
        """The term of the loss that charges opacity and scales."""
        parameters, options = self._gaussians.parameters, self._relocation
        opacity = torch.sigmoid(parameters["opacity_logits"]).mean()
        return (
            options.opacity_cost * opacity + options.scale_cost * parameters["log_scales"].exp().mean() / self._extent
        )

    def record(self, statistics: ViewStatistics, width: int, height: int) -> None:
        """Ignored: sampling doesn't depend on gradients."""

    def after_step(self, step: int, progress: float) -> bool:
        """Move and add Gaussians if it is due, and add noise to all; True when Gaussians were moved or added."""
        density = self._density
        changed = self.pace.due(step) and density.densify_from <= progress < density.densify_until
        if changed:
            self._move_transparent()
            self._add_copies()
        self._add_noise()
        return changed

    @torch.no_grad()
    def _move_transparent(self) -> None:
        """Move transparent Gaussians to opaque ones, drawn by opacity."""
        opacity = torch.sigmoid(self._gaussians.parameters["opacity_logits"].detach())
        dead = torch.nonzero(opacity <= self._density.prune_opacity)[:, 0]
        alive = torch.nonzero(opacity > self._density.prune_opacity)[:, 0]
        if len(dead) and len(alive):
            self._copy(alive[self._draw(opacity[alive], len(dead))], dead)

    @torch.no_grad()
    def _add_copies(self) -> None:
        """Add a share of the Gaussians, up to the limit, as copies drawn by opacity."""
        count = len(self._gaussians)
        more = min(self._density.max_gaussians, int((1 + _GROWTH) * count)) - count
        if more <= 0:
            return
        opacity = torch.sigmoid(self._gaussians.parameters["opacity_logits"].detach())
        drawn = self._draw(opacity, more)
        kept = torch.arange(count, device=opacity.device)
        added = {name: self._gaussians.parameters[name].detach()[drawn].clone() for name in PARAMETERS}
        self._optimiser.rebuild(kept, added)
        self._copy(drawn, count + torch.arange(more, device=drawn.device))

    def _draw(self, weights: Tensor, count: int) -> Tensor:
        """(count,) indices drawn in proportion to the weights, with replacement, by the host's generator."""
        host = weights.to(self._generator.device)
        found = torch.multinomial(host, count, replacement=True, generator=self._generator)
        return found.to(weights.device)

    def _copy(self, drawn: Tensor, places: Tensor) -> None:
        """Make the Gaussians in `places` copies of those drawn, and let each with its copies look as it did alone.

        Moments of both start again.
        """
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
    def _add_noise(self) -> None:
        """Add noise with each transparent Gaussian's own covariance to its mean."""
        parameters = {name: value.detach() for name, value in self._gaussians.parameters.items()}
        # The generator is the host's, so that a seed draws the same noise on every device.
        normal = torch.randn(parameters["means"].shape, generator=self._generator, device=self._generator.device)
        scales, quaternions = parameters["log_scales"].exp(), parameters["quaternions"]
        inverse = quaternions * beside(quaternions, [1.0, -1.0, -1.0, -1.0])
        noise = rotate(quaternions, scales.square() * rotate(inverse, normal.to(scales.device)))
        opacity = torch.sigmoid(parameters["opacity_logits"])
        transparent = torch.sigmoid(-_STEEP * (opacity - self._density.prune_opacity))
        strength = self._relocation.noise_lr * self._optimiser.means_rate
        parameters["means"] += strength * transparent[:, None] * noise


def shared_among(opacity: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """The opacity, and the factor on the scales, of copies of a Gaussian that together look as it does alone.

    opacity: (N,), and copies: (N,), at least 1; more than 51 count as 51. One behind the other they let as much light
    through, and the integral over the image is the same (3DGS-MCMC, Eq. 9).
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


@dataclass(frozen=True)
class SplattingOptions(GaussianOptions):
    """The trainer's options with 3DGS's appearance and density control."""

    appearance: DilatedAppearance = DilatedAppearance()
    density: PrunedDensity = PrunedDensity()
    relocation: RelocationOptions = RelocationOptions()

    def first_gaussians(self, points: PointCloud | None, device: str) -> Gaussians:
        """As the trainer's, or with the opacities and scales that density control by sampling begins with."""
        gaussians = super().first_gaussians(points, device)
        if self.relocation.mcmc:
            with torch.no_grad():
                opacity = self.relocation.init_opacity
                gaussians.parameters["opacity_logits"].fill_(math.log(opacity / (1 - opacity)))
                gaussians.parameters["log_scales"] += math.log(self.relocation.init_scale)
        return gaussians

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl:
        if self.relocation.mcmc:
            return Relocation(gaussians, optimiser, self.density, self.relocation, extent, generator)
        return super().density_control(gaussians, optimiser, extent, generator)


class Splatting(GaussianMethod):
    """The shared trainer without a lens and without Mip-Splatting's filters."""

    OPTIONS = SplattingOptions
    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off", "filter_3d": False}
