"""All options of the Gaussian trainer. Each group is declared in the module that uses it; here they are combined."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.training.common.depth import SupervisionOptions
from dofbench.training.common.lenses import LensOptions
from dofbench.training.common.losses import AdaptationOptions, ReconstructionOptions
from dofbench.training.common.options import OptionGroups
from dofbench.training.common.photograph_colours import ColourOptions
from dofbench.training.common.priors import PriorOptions
from dofbench.training.common.views import OutlierOptions
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.early_stopping import StoppingOptions
from dofbench.training.gaussians.forward_model import BlurOptions, BlurStart, LearnedBlur, Pinhole
from dofbench.training.gaussians.lens_models import ForwardSchedule, SamplesOptions, ScatterOptions, training_models
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions
from dofbench.training.gaussians.render import AppearanceOptions
from dofbench.training.gaussians.surface_losses import DistortionOptions, NormalOptions

QUESTIONS = ("lens", "share", "model")


@dataclass(frozen=True)
class ScheduleOptions:
    """Length, the coarse beginning and the cooldown at the end.

    Times are shares of the training, 0 to 1, so a schedule keeps its shape under any budget; published schedules run
    over 30 000 steps (DoF-Gaussian section 5, Mip-Splatting, 3DGS).
    """

    steps: int = 7000
    """Length of the training if the budget doesn't give it. Unit: steps. Source: own; 30 000 in the
    paper."""
    coarse_until: float = 0.0
    """Train on shrunk photographs up to this share of the training. Unit: share of the training. Source: own."""
    coarse_factor: int = 2
    """How many times smaller the shrunk photographs are along each side. Unit: none. Source: own."""
    cooldown_from: float = 1.0
    """When all learning rates, the lens's too, begin to fall linearly; 1 for never. Unit: share of the training.
    Source: own."""
    cooldown_to: float = 0.1
    """Factor on all learning rates at the end of this fall. Unit: none. Source: own."""

    def cooldown(self, progress: float) -> float:
        """The factor on all learning rates at `progress`, 0 to 1."""
        if progress <= self.cooldown_from:
            return 1.0
        return 1.0 - (1.0 - self.cooldown_to) * (progress - self.cooldown_from) / (1.0 - self.cooldown_from)

    def rate_progress(self, progress: float) -> float:
        """How far the fall of the means' rate is at `progress`; both 0 to 1."""
        return progress

    @property
    def sizes(self) -> tuple[int, ...]:
        """The factors by which views are shrunk in the course of the training; 1 is full size."""
        return (1, self.coarse_factor) if self.coarse_until > 0 and self.coarse_factor != 1 else (1,)

    def sizes_from(self, progress: float) -> tuple[int, ...]:
        """Those of `sizes` that are still to come at `progress`, 0 to 1."""
        return self.sizes if progress < self.coarse_until else (1,)

    def size(self, progress: float) -> int:
        """The factor by which views are shrunk at `progress`, 0 to 1."""
        return self.coarse_factor if progress < self.coarse_until else 1


@dataclass(frozen=True)
class TrialOptions:
    """Which questions are decided by trials while training, when, and how long a trial is."""

    lens_trials: str = ""
    """Questions that trials decide by the scores on held-out pixels, comma-separated: lens (is there one), share (do
    photographs share it), model (which forward model). Unit: none. Source: own."""
    lens_trials_at: float = 0.35
    """When the trials take place. Unit: share of the training. Source: own."""
    lens_trials_steps: float = 0.03
    """Length of each trial; beyond 200 steps only as far as its visits need it. Unit: share of the training. Source:
    own."""

    lens_trials_from: float = 0.0
    """PSNR of the training photographs from which trials ask about a lens; below, or where renderings have less than
    half the photographs' detail, the scene isn't reconstructed. 0 for any. Unit: dB. Source: own."""

    def __post_init__(self) -> None:
        unknown = sorted(set(filter(None, self.lens_trials.split(","))) - set(QUESTIONS))
        if unknown:
            raise InputError("option lens_trials", repr(unknown[0]), "some of lens, share, model, with commas")


@dataclass(frozen=True)
class GaussianOptions(OptionGroups):
    """Options of a Gaussian method, grouped by purpose, which presets and `--set key=value` can set.

    The methods are hooks by which a method replaces parts of the trainer.
    """

    schedule: ScheduleOptions = ScheduleOptions()
    appearance: AppearanceOptions = AppearanceOptions()
    rates: RateOptions = RateOptions()
    density: DensityOptions = DensityOptions()
    reconstruction: ReconstructionOptions = ReconstructionOptions()
    stopping: StoppingOptions = StoppingOptions()
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
        if self.stopping.patience > 0 and self.reconstruction.held_back == 0:
            raise InputError("option patience", f"{self.stopping.patience:g} with held_back=0", "held_back above 0")

    def forward_models(self) -> ForwardSchedule:
        """The forward models of a training, if no other blur is learned."""
        models = training_models(self.lens.lens, self.blur, self.scatter, self.samples)
        return models.after(Pinhole(), self.lens.lens_free_until) if self.lens.lens else models

    def first_gaussians(self, points: PointCloud | None, device: str) -> Gaussians:
        """The Gaussians that training starts from. Raises the errors of `Gaussians.from_points`."""
        return Gaussians.from_points(points, self.appearance.sh_degree, device)

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl:
        """The density control. extent: of the scene, scene units. generator: for all that it draws."""
        return DensityControl(gaussians, optimiser, self.density, extent, generator)

    def learned_blur(self, start: BlurStart) -> LearnedBlur | None:
        """The blur that is learned for the views without a lens; None for none."""
        return None
