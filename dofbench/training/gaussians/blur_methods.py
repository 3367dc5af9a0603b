"""Gaussian methods that learn a blur for every photograph, other than a lens's: bases that a method's folder names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from dofbench.runtime.device_numbers import beside
from dofbench.training.common.training_schedule import ScheduleOptions
from dofbench.training.gaussians.density import DensityControl
from dofbench.training.gaussians.extra_points import ExtraOptions, GrowingOnce
from dofbench.training.gaussians.forward.circle_copies import CircleCopies, CopiesOptions
from dofbench.training.gaussians.forward.enlarged_gaussians import EnlargedGaussians, EnlargingOptions
from dofbench.training.gaussians.forward.focused_blur import FocusedBlur, FocusOptions
from dofbench.training.gaussians.forward.forward_model import BlurStart, LearnedBlur
from dofbench.training.gaussians.forward.forward_schedule import ForwardSchedule
from dofbench.training.gaussians.forward.masked_blur import MaskedBlur, MaskOptions
from dofbench.training.gaussians.forward.proposed_blur import ProposalOptions, ProposedBlur
from dofbench.training.gaussians.forward.uniform_blur import UniformBlur, UniformBlurOptions
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser


class LearnedBlurMethod(GaussianMethod):
    """Blur that isn't a lens's, so there is none, and no adaptation to it."""

    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off"}


@dataclass(frozen=True)
class UniformlyBlurredOptions(GaussianOptions):
    """Those of the trainer, and of the blur of whole photographs."""

    uniform: UniformBlurOptions = UniformBlurOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """See `UniformBlur`."""
        return UniformBlur(len(start.cameras), self.uniform, start.device)


class UniformlyBlurred(LearnedBlurMethod):
    """One blur for each photograph, as in Robust Gaussian Splatting."""

    OPTIONS = UniformlyBlurredOptions


@dataclass(frozen=True)
class GrownOnceOptions(GaussianOptions):
    """Those of the trainer, and of points that are added once."""

    extra: ExtraOptions = ExtraOptions()

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl:
        """By gradients, and points added once."""
        return GrowingOnce(gaussians, optimiser, self.density, self.extra, extent, generator)


@dataclass(frozen=True)
class EnlargedOptions(GrownOnceOptions):
    """Those of the trainer, of added points, and of the network that enlarges Gaussians."""

    enlarging: EnlargingOptions = EnlargingOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """See `EnlargedGaussians`."""
        return self.enlarged(start)

    def enlarged(self, start: BlurStart) -> EnlargedGaussians:
        """The enlarging network, whose places begin at the mean of the cameras, in units of the scene's extent."""
        return EnlargedGaussians(start.place, start.extent, self.enlarging, start.generator)


class Enlarged(LearnedBlurMethod):
    """Gaussians enlarged by a network, as in Deblurring 3D Gaussian Splatting."""

    OPTIONS = EnlargedOptions


@dataclass(frozen=True)
class MaskedOptions(EnlargedOptions):
    """Those of enlarged Gaussians, and of the mask."""

    mask: MaskOptions = MaskOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """See `MaskedBlur`."""
        return MaskedBlur(self.enlarged(start), len(start.cameras), self.mask, start.generator, start.device)


class Masked(LearnedBlurMethod):
    """Enlarged Gaussians and sharp ones mixed by a mask, as in gsplat's defocus module."""

    OPTIONS = MaskedOptions


@dataclass(frozen=True)
class CopiedOptions(GrownOnceOptions):
    """Those of the trainer, of added points, and of the copies of the scene."""

    copies: CopiesOptions = CopiesOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """See `CircleCopies`; photographs begin to be focused at the mean distance of the Gaussians."""
        centres = beside(start.means, [camera.centre for camera in start.cameras])
        first = torch.stack([(start.means - centre).norm(dim=1).mean() for centre in centres])
        return CircleCopies(first, start.place, start.extent, self.copies, start.generator)


class Copied(LearnedBlurMethod):
    """Photographs mixed from the scene and copies of it, as in CoCoGaussian."""

    OPTIONS = CopiedOptions


@dataclass(frozen=True)
class ThreeScales(ScheduleOptions):
    """A schedule that begins with photographs of a quarter of their size."""

    quarter_until: float = 0.1
    """Train on photographs of a quarter of their size up to here, and on those of half their size up to coarse_until.
    Unit: share of the training. Source: BAGS, step 3000 of about 30 000."""
    coarse_until: float = 0.2
    """Train on shrunk photographs up to this share of the training. Unit: share of the training. Source: BAGS, step
    6000."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """1, 2 and 4, but for scales that last no time."""
        lasting = {1: 1.0, 2: self.coarse_until - self.quarter_until, 4: self.quarter_until}
        return tuple(factor for factor, time in lasting.items() if time > 0)

    def size(self, progress: float) -> int:
        """4, 2 or 1."""
        return 4 if progress < self.quarter_until else 2 if progress < self.coarse_until else 1


@dataclass(frozen=True)
class ProposedOptions(GaussianOptions):
    """Those of the trainer, on three scales, and of the network that proposes blur."""

    schedule: ThreeScales = ThreeScales()
    proposal: ProposalOptions = ProposalOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """See `ProposedBlur`."""
        return ProposedBlur([camera.width for camera in start.cameras], self.proposal, start.generator, start.device)


class Proposed(LearnedBlurMethod):
    """Blur proposed for every pixel by a network, as in BAGS."""

    OPTIONS = ProposedOptions
    FORCED: ClassVar[Mapping[str, Any]] = {**LearnedBlurMethod.FORCED, "coarse_factor": 2}


@dataclass(frozen=True)
class FocusedOptions(GaussianOptions):
    """Those of the trainer, and of the loss where photographs are in focus."""

    focus: FocusOptions = FocusOptions()

    def forward_models(self) -> ForwardSchedule:
        """See `FocusedBlur`, all the time."""
        return ForwardSchedule([(0.0, FocusedBlur(self.blur, self.focus))])


class Focused(GaussianMethod):
    """Every Gaussian enlarged by its circle of confusion, and the sharp view compared where photographs are in focus,
    as in DOF-GS."""

    OPTIONS = FocusedOptions
    # Trials would compare forward models, of which this method has one.
    FORCED: ClassVar[Mapping[str, Any]] = {
        "lens": True,
        "lens_model": "samples",
        "lens_rings": 0,
        "lens_trials": "",
        "adaptation": "off",
    }
