"""Which forward model is used at which time of the training, and which one renders trained scenes."""

from __future__ import annotations

from collections.abc import Sequence

from dofbench.training.gaussians.forward.forward_model import BlurOptions, ForwardModel
from dofbench.training.gaussians.forward.lens_pattern import MOST_RINGS
from dofbench.training.gaussians.forward.lens_samples import LensSamples, SamplesOptions
from dofbench.training.gaussians.forward.own_blur import OwnBlur
from dofbench.training.gaussians.forward.pinhole import Pinhole
from dofbench.training.gaussians.forward.scatter_blur import ScatterBlur, ScatterOptions


class ForwardSchedule:
    """Forward models, each with the share of the training from which it is used; the first model starts at 0."""

    def __init__(self, models: Sequence[tuple[float, ForwardModel]]):
        self._models = tuple(models)

    def at(self, progress: float) -> ForwardModel:
        """The model at `progress`, 0 to 1: the last one whose start has been reached."""
        return [model for start, model in self._models if start <= progress][-1]

    @property
    def models(self) -> tuple[ForwardModel, ...]:
        """All models of the schedule, in order."""
        return tuple(model for _, model in self._models)


def training_models(lens: bool, blur: BlurOptions, scatter: ScatterOptions, samples: SamplesOptions) -> ForwardSchedule:
    """The forward models of a training. With lens_model=samples the training starts with the scatter, which finds
    roughly where the lens is focused, goes on with the lens's centre alone, and uses rings of lens points last, since
    every point costs a rasterisation."""
    if not lens:
        return ForwardSchedule([(0.0, Pinhole())])
    models: list[tuple[float, ForwardModel]] = [(0.0, ScatterBlur(blur, scatter))]
    if blur.lens_model == "samples":
        models.append((samples.lens_samples_from, OwnBlur(blur)))
        if samples.lens_rings > 0:
            start = max(samples.lens_samples_from, samples.lens_rings_from)
            models.append((start, LensSamples(blur, samples.lens_rings)))
    return ForwardSchedule(models)


def rendering_model(blur: BlurOptions, scatter: ScatterOptions, samples: SamplesOptions) -> ForwardModel:
    """The forward model that renders a trained scene. It may use more lens points than training did, where a picture's
    circles of confusion are wide."""
    if blur.lens_model == "scatter":
        return ScatterBlur(blur, scatter)
    return LensSamples(blur, max(samples.lens_rings, MOST_RINGS)) if samples.lens_rings > 0 else OwnBlur(blur)
