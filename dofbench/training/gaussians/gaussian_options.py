"""All options of the Gaussian trainer. Each group of options is declared in the module that uses it; here they are
combined."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.training.common.adaptation import AdaptationOptions
from dofbench.training.common.depth_loss import SupervisionOptions
from dofbench.training.common.image_losses import ReconstructionOptions
from dofbench.training.common.lenses import LensOptions
from dofbench.training.common.option_groups import OptionGroups
from dofbench.training.common.outliers import OutlierOptions
from dofbench.training.common.photograph_colours import ColourOptions
from dofbench.training.common.priors import PriorOptions
from dofbench.training.common.training_schedule import ScheduleOptions
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.distortion import DistortionOptions
from dofbench.training.gaussians.forward.forward_model import BlurOptions, BlurStart, LearnedBlur
from dofbench.training.gaussians.forward.forward_schedule import ForwardSchedule, training_models
from dofbench.training.gaussians.forward.lens_samples import SamplesOptions
from dofbench.training.gaussians.forward.scatter_blur import ScatterOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.normals import NormalOptions
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions
from dofbench.training.gaussians.relocation import Relocation
from dofbench.training.gaussians.render import AppearanceOptions
from dofbench.training.gaussians.trial_options import TrialOptions


@dataclass(frozen=True)
class GaussianOptions(OptionGroups):
    """The options of a Gaussian method that presets in `method.toml` and `--set key=value` can set, grouped by
    purpose."""

    schedule: ScheduleOptions = ScheduleOptions()
    appearance: AppearanceOptions = AppearanceOptions()
    rates: RateOptions = RateOptions()
    density: DensityOptions = DensityOptions()
    reconstruction: ReconstructionOptions = ReconstructionOptions()
    outliers: OutlierOptions = OutlierOptions()
    colours: ColourOptions = ColourOptions()
    lens: LensOptions = LensOptions()
    blur: BlurOptions = BlurOptions()
    scatter: ScatterOptions = ScatterOptions()
    samples: SamplesOptions = SamplesOptions()
    trials: TrialOptions = TrialOptions()
    supervision: SupervisionOptions = SupervisionOptions()
    prior: PriorOptions = PriorOptions()
    normals: NormalOptions = NormalOptions()
    distortion: DistortionOptions = DistortionOptions()
    adaptation: AdaptationOptions = AdaptationOptions()

    def __post_init__(self) -> None:
        if self.blur.lens_model == "samples" and self.scatter.lens_blades:
            raise InputError("option lens_blades", f"{self.scatter.lens_blades} with lens_model=samples", "0: a disc")

        if self.density.reset_filtered and not self.appearance.filter_3d:
            raise InputError("option reset_filtered", "true with filter_3d=false", "false: there is no filter")

    def forward_models(self) -> ForwardSchedule:
        """The forward models of a training with these options, if no other blur is learned."""
        return training_models(self.lens.lens, self.blur, self.scatter, self.samples)

    def first_gaussians(self, points: PointCloud | None, device: str) -> Gaussians:
        """The Gaussians that training starts from. Raises the errors of `Gaussians.from_points`."""
        return Gaussians.from_points(points, self.appearance.sh_degree, device)

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl | Relocation:
        """What adds and removes Gaussians. extent: of the scene, scene units. generator: for all that it draws."""
        return DensityControl(gaussians, optimiser, self.density, extent, generator)

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """The blur other than a lens's that is learned for the photographs; None for none."""
        return None
