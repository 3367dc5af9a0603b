"""Radiance fields with a learned blur kernel for every view: sharp scenes from blurred photographs, without a lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from dofbench.core.contracts import TrainingSet
from dofbench.core.lens import DisparityRange
from dofbench.training.common.supervision import all_disparities
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.forward.blur_kernels import KernelOptions
from dofbench.training.fields.forward.deformable_kernel import DeformableKernel, DeformableOptions
from dofbench.training.fields.forward.progressive_kernel import ProgressiveKernel, ProgressiveOptions
from dofbench.training.fields.forward.ray_model import RayModel
from dofbench.training.fields.forward.rigid_kernel import RigidKernel
from dofbench.training.fields.forward.weight_proposal import WeightProposalOptions

_UNIT = 0.75  # of the nearest points' depth: Deblur-NeRF scales LLFF's scenes so that they lie beyond 4 / 3


@dataclass(frozen=True)
class KernelFieldOptions(FieldOptions):
    """Those of a radiance field, and of its blur kernels."""

    kernel: KernelOptions = KernelOptions()


@dataclass(frozen=True)
class DeformableFieldOptions(KernelFieldOptions):
    """Those of a field with deformable sparse kernels."""

    deformable: DeformableOptions = DeformableOptions()


@dataclass(frozen=True)
class RigidFieldOptions(KernelFieldOptions):
    """Those of a field with rigid blurring kernels."""

    proposal: WeightProposalOptions = WeightProposalOptions()


@dataclass(frozen=True)
class ProgressiveFieldOptions(KernelFieldOptions):
    """Those of a field with progressively estimated kernels."""

    kernel: ProgressiveOptions = ProgressiveOptions()


class DeformableField(FieldMethod):
    """Photographs mixed by Deblur-NeRF's deformable sparse kernel."""

    OPTIONS = DeformableFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """See `DeformableKernel`."""
        options = self._options
        assert isinstance(options, DeformableFieldOptions)
        views, unit = len(training_set.views), unit_of_depth(training_set)
        return DeformableKernel(views, unit, options.kernel, options.deformable, generator, self._device)


class RigidField(FieldMethod):
    """Photographs mixed by DP-NeRF's rigid blurring kernel."""

    OPTIONS = RigidFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """See `RigidKernel`; rotations turn about the mean of the cameras' places."""
        options = self._options
        assert isinstance(options, RigidFieldOptions)
        centre = np.mean([view.camera.centre for view in training_set.views], axis=0)
        views, unit, channels = len(training_set.views), unit_of_depth(training_set), options.grid.feature_count
        return RigidKernel(views, centre, unit, channels, options.kernel, options.proposal, generator, self._device)


class ProgressiveField(FieldMethod):
    """Photographs mixed by PDRF's kernel, which is estimated in two stages."""

    OPTIONS = ProgressiveFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """See `ProgressiveKernel`."""
        options = self._options
        assert isinstance(options, ProgressiveFieldOptions)
        views, unit = len(training_set.views), unit_of_depth(training_set)
        return ProgressiveKernel(views, unit, options.grid.feature_count, options.kernel, generator, self._device)


def unit_of_depth(training_set: TrainingSet) -> float:
    """The depth, scene units, that counts as 1 for kernels."""
    assert training_set.points is not None
    cameras = [view.camera for view in training_set.views]
    return _UNIT / DisparityRange.of_disparity(all_disparities(training_set.points, cameras)).q_max
