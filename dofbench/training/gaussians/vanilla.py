"""3D Gaussian Splatting as it was published (Kerbl et al., SIGGRAPH 2023), on the shared trainer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from dofbench.core.contracts import PointCloud
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser
from dofbench.training.gaussians.relocation import Relocation, RelocationOptions
from dofbench.training.gaussians.render import AppearanceOptions


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
        """False: opacities are kept."""
        return False


@dataclass(frozen=True)
class PrunedDensity(DensityOptions):
    """Large Gaussians are removed, too."""

    prune_scale: float = 0.1
    """Scale above which a Gaussian is removed, after the first reset of opacities. Unit: share of the scene's extent.
    Source: 3DGS."""

    @property
    def largest_kept(self) -> float:
        """The option."""
        return self.prune_scale


@dataclass(frozen=True)
class VanillaOptions(GaussianOptions):
    """Those of the trainer, with 3DGS's appearance and density control."""

    appearance: DilatedAppearance = DilatedAppearance()
    density: PrunedDensity = PrunedDensity()
    relocation: RelocationOptions = RelocationOptions()

    def first_gaussians(self, points: PointCloud | None, device: str) -> Gaussians:
        """As always, or with the opacities and scales that density control by sampling begins with."""
        gaussians = super().first_gaussians(points, device)
        if self.relocation.mcmc:
            with torch.no_grad():
                opacity = self.relocation.init_opacity
                gaussians.parameters["opacity_logits"].fill_(math.log(opacity / (1 - opacity)))
                gaussians.parameters["log_scales"] += math.log(self.relocation.init_scale)
        return gaussians

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl | Relocation:
        """By gradients, or by sampling."""
        if self.relocation.mcmc:
            return Relocation(gaussians, optimiser, self.density, self.relocation, extent, generator)
        return super().density_control(gaussians, optimiser, extent, generator)


class Vanilla(GaussianMethod):
    """3DGS: the same trainer without a lens and without Mip-Splatting's filters."""

    OPTIONS = VanillaOptions
    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off", "filter_3d": False}
