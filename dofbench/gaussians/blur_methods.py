"""Gaussian methods that learn a blur for every photograph, other than a lens's: bases that a method's folder names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.gaussians.forward.enlarged_gaussians import EnlargedGaussians, EnlargingOptions
from dofbench.gaussians.forward.focused_blur import FocusedBlur, FocusOptions
from dofbench.gaussians.forward.forward_model import LearnedBlur
from dofbench.gaussians.forward.forward_schedule import ForwardSchedule
from dofbench.gaussians.forward.uniform_blur import UniformBlur, UniformBlurOptions
from dofbench.gaussians.gaussian_method import GaussianMethod
from dofbench.gaussians.gaussian_options import GaussianOptions

_NO_LENS: Mapping[str, Any] = {"lens": False, "adaptation": "off"}


@dataclass(frozen=True)
class UniformlyBlurredOptions(GaussianOptions):
    """Those of the trainer, and of the blur of whole photographs."""

    uniform: UniformBlurOptions = UniformBlurOptions()

    def learned_blur(self, cameras: Sequence[Camera], extent: float, generator: torch.Generator) -> LearnedBlur | None:
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

    def learned_blur(self, cameras: Sequence[Camera], extent: float, generator: torch.Generator) -> LearnedBlur | None:
        """See `EnlargedGaussians`; its places begin at the mean of the cameras, in units of the scene's extent."""
        origin = torch.from_numpy(np.mean([camera.centre for camera in cameras], axis=0)).float()
        return EnlargedGaussians(origin, extent, self.enlarging, generator)


class Enlarged(GaussianMethod):
    """Gaussians enlarged by a network, as in Deblurring 3D Gaussian Splatting."""

    OPTIONS = EnlargedOptions
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
