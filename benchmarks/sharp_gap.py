"""Why a scene that was learned from shallow photographs has a worse sharp picture than one from sharp photographs: the
error of the forward model, or what the photographs still show.

    python benchmarks/sharp_gap.py DATASET [--steps 1500]

A scene is learned from the sharp originals. Printed are, first, how well each forward model photographs that scene
through the true lenses, against the dataset's photographs: the error of a model on a scene that it didn't learn. Then
the scene itself takes the place of the world: its sharp views, and its views from five points of the true lenses, are
rounded to 8 bits, and a new scene is learned from each by the same preset; from the latter with those same points, and
so without any error of the model. What then still differs in the sharp test views is due to the photographs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import Status
from dofbench.dataset.dataset import Dataset, DatasetView
from dofbench.gaussians.exposure import StillRasteriser, render_view
from dofbench.gaussians.forward.lens_pattern import cell_variance, lens_points, points_of
from dofbench.gaussians.forward.lens_samples import depth_of, together
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.step_rasteriser import StepRasteriser
from dofbench.gaussians.trainer import Trainer
from dofbench.running.method_cards import find_method

NO_LENS = {"lens": False, "lens_trials": ""}
FIVE_POINTS = {"lens_trials": "lens,share", "lens_model": "samples", "lens_samples_from": 0.2, "lens_rings": 1}
IN_FOCUS, OUT_OF_FOCUS = 0.5, 2.0  # px, radius of the true circle of confusion

Picture = Callable[[DatasetView], np.ndarray]


@dataclass(frozen=True)
class Settings:
    """What to train on, and how long."""

    data: tyro.conf.Positional[Path]
    """Dataset with per-view lenses."""
    steps: int = 1500
    """Training steps of each of the three trainings."""


def main(settings: Settings) -> None:
    """Print both tables."""
    configure_threads()
    dataset = Dataset.load(settings.data)
    _, preset, _ = find_method("dofgaussian").preset(None)
    options = GaussianOptions().with_overrides({**preset})

    def learned(training_set: TrainingSet, changes: dict[str, object]) -> Gaussians:
        trainer = Trainer(training_set, options.with_overrides(changes), 0)
        outcome = trainer.fit(Budget(steps=settings.steps), Unobserved())
        if outcome.status is not Status.OK:
            raise SystemExit(f"{outcome.status}: {outcome.message}")
        return trainer.gaussians

    world = learned(dataset.training_set("all-in-focus"), NO_LENS)
    print("| forward model | photographs of the training views [dB] |\n| :--- | ---: |", flush=True)
    for name, picture in forward_models(world, options).items():
        error = [np.square(np.clip(picture(view), 0, 1) - dataset.image(view)) for view in dataset.training_views()]
        print(f"| {name} | {np.mean([psnr(one) for one in error]):.2f} |", flush=True)

    # Training turns the pattern of lens points from step to step; the photographs were taken with an unturned one.
    StepRasteriser.turn = lambda self: 0.0  # type: ignore[method-assign]
    sharp = eight_bits(lambda view: render_view(world, view.camera, options, lens=None).image)
    shallow = eight_bits(from_points(world, options, rings=1))
    print("\n| learned from | in focus [dB] | out of focus | sharp test views |\n| :--- | ---: | ---: | ---: |")
    for name, picture, changes in (("sharp views", sharp, NO_LENS), ("shallow views", shallow, FIVE_POINTS)):
        scene = learned(photographed(dataset, picture), changes)
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in scores(scene, options, dataset, sharp)) + " |")


def forward_models(world: Gaussians, options: GaussianOptions) -> dict[str, Picture]:
    """Photographs of a scene through the true lenses, by the name of the forward model."""
    scatter = options.with_overrides({"lens_model": "scatter"})
    models: dict[str, Picture] = {
        "scatter": lambda view: render_view(world, view.camera, scatter, lens=view.physical_lens).image
    }
    for rings in range(4):
        models[f"points of the lens: {points_of(rings)}"] = from_points(world, options, rings)
    return models


def from_points(world: Gaussians, options: GaussianOptions, rings: int) -> Picture:
    """Photographs by an unturned pattern of lens points."""
    scene = StillRasteriser(world, options.appearance)

    @torch.no_grad()
    def picture(view: DatasetView) -> np.ndarray:
        radius = Shot.through(view.physical_lens, view.camera).radius(1 / depth_of(world, view.camera))
        views = scene.from_points(view.camera, lens_points(rings), radius, cell_variance(radius, rings))
        return together(views, options.blur.lens_gamma).numpy()

    return picture


def eight_bits(picture: Picture) -> Picture:
    """The pictures, clipped and rounded as an 8-bit file holds them."""
    return lambda view: (np.round(np.clip(picture(view), 0, 1) * 255) / 255).astype(np.float32)


def photographed(dataset: Dataset, picture: Picture) -> TrainingSet:
    """The training set with other photographs."""
    taken, shown = dataset.training_set(), {view.name: view for view in dataset.training_views()}
    return replace(taken, views=tuple(replace(view, image=picture(shown[view.name])) for view in taken.views))


def scores(scene: Gaussians, options: GaussianOptions, dataset: Dataset, truth: Picture) -> tuple[float, float, float]:
    """PSNR, dB, of the scene's sharp training views where their photographs are in focus, where they are out of focus,
    and of its sharp test views."""

    def error(view: DatasetView) -> np.ndarray:
        image = render_view(scene, view.camera, options, lens=None).image
        return np.square(np.clip(image, 0, 1) - truth(view)).mean(axis=-1)

    on, off = [], []
    for view in dataset.training_views():
        depth = dataset.depth(view)
        radius = np.abs(view.physical_lens.signed_radius(1 / np.where(depth > 0, depth, np.inf), view.camera.width))
        on.append(error(view)[radius < IN_FOCUS])
        off.append(error(view)[radius > OUT_OF_FOCUS])
    tests = np.mean([psnr(error(view)) for view in dataset.test_views()])
    return psnr(np.concatenate(on)), psnr(np.concatenate(off)), float(tests)


def psnr(squared: np.ndarray) -> float:
    """dB, of squared errors."""
    return float(-10 * np.log10(squared.mean()))


if __name__ == "__main__":
    main(tyro.cli(Settings))
