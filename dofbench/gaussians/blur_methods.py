"""Gaussian methods that learn a blur for every photograph, other than a lens's: bases that a method's folder names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.gaussians.forward.circle_copies import CircleCopies, CopiesOptions
from dofbench.gaussians.forward.enlarged_gaussians import EnlargedGaussians, EnlargingOptions
from dofbench.gaussians.forward.focused_blur import FocusedBlur, FocusOptions
from dofbench.gaussians.forward.forward_model import LearnedBlur
from dofbench.gaussians.forward.forward_schedule import ForwardSchedule
from dofbench.gaussians.forward.masked_blur import MaskedBlur, MaskOptions
from dofbench.gaussians.forward.uniform_blur import UniformBlur, UniformBlurOptions
from dofbench.gaussians.gaussian_method import GaussianMethod
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.model import Gaussians

_NO_LENS: Mapping[str, Any] = {"lens": False, "adaptation": "off"}


@dataclass(frozen=True)
class UniformlyBlurredOptions(GaussianOptions):
    """Those of the trainer, and of the blur of whole photographs."""

    uniform: UniformBlurOptions = UniformBlurOptions()

    def learned_blur(
        self, gaussians: Gaussians, cameras: Sequence[Camera], extent: float, generator: torch.Generator
    ) -> LearnedBlur | None:
        """See `UniformBlur`."""
        return UniformBlur(len(cameras), self.uniform)


class UniformlyBlurred(GaussianMethod):
    """One blur for each photograph, as in Robust Gaussian Splatting."""

    OPTIONS = UniformlyBlurredOptions
    FORCED: ClassVar[Mapping[str, Any]] = _NO_LENS


@dataclass(frozen=True)
class EnlargedOptions(GaussianOptions):
    """Those of the trainer, and of the network that enlarges Gaussians."""

    enlarging: EnlargingOptions = EnlargingOptions()

    def learned_blur(
        self, gaussians: Gaussians, cameras: Sequence[Camera], extent: float, generator: torch.Generator
    ) -> LearnedBlur | None:
        """See `EnlargedGaussians`."""
        return self.enlarged(cameras, extent, generator)

    def enlarged(self, cameras: Sequence[Camera], extent: float, generator: torch.Generator) -> EnlargedGaussians:
        """The enlarging network, whose places begin at the mean of the cameras, in units of the scene's extent."""
        return EnlargedGaussians(mean_place(cameras), extent, self.enlarging, generator)


class Enlarged(GaussianMethod):
    """Gaussians enlarged by a network, as in Deblurring 3D Gaussian Splatting."""

    OPTIONS = EnlargedOptions
    FORCED: ClassVar[Mapping[str, Any]] = _NO_LENS


@dataclass(frozen=True)
class MaskedOptions(EnlargedOptions):
    """Those of enlarged Gaussians, and of the mask."""

    mask: MaskOptions = MaskOptions()

    def learned_blur(
        self, gaussians: Gaussians, cameras: Sequence[Camera], extent: float, generator: torch.Generator
    ) -> LearnedBlur | None:
        """See `MaskedBlur`."""
        return MaskedBlur(self.enlarged(cameras, extent, generator), len(cameras), self.mask, generator)


class Masked(GaussianMethod):
    """Enlarged Gaussians and sharp ones mixed by a mask, as in gsplat's defocus module."""

    OPTIONS = MaskedOptions
    FORCED: ClassVar[Mapping[str, Any]] = _NO_LENS


@dataclass(frozen=True)
class CopiedOptions(GaussianOptions):
    """Those of the trainer, and of the copies of the scene."""

    copies: CopiesOptions = CopiesOptions()

    def learned_blur(
        self, gaussians: Gaussians, cameras: Sequence[Camera], extent: float, generator: torch.Generator
    ) -> LearnedBlur | None:
        """See `CircleCopies`; photographs begin to be focused at the mean distance of the Gaussians."""
        means = gaussians.parameters["means"].detach()
        centres = torch.from_numpy(np.stack([camera.centre for camera in cameras])).float()
        first = torch.stack([(means - centre).norm(dim=1).mean() for centre in centres])
        return CircleCopies(first, mean_place(cameras), extent, self.copies, generator)


class Copied(GaussianMethod):
    """Photographs mixed from the scene and copies of it, as in CoCoGaussian."""

    OPTIONS = CopiedOptions
    FORCED: ClassVar[Mapping[str, Any]] = _NO_LENS


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


def mean_place(cameras: Sequence[Camera]) -> torch.Tensor:
    """(3,) the mean of the cameras' places, scene units."""
    return torch.from_numpy(np.mean([camera.centre for camera in cameras], axis=0)).float()
