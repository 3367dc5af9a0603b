"""Which weight of defocus-to-focus adaptation has the effect that the paper's text describes: emphasis on pixels in
focus.

    python benchmarks/adaptation.py DATASET [--steps 1500] [--seeds 3]

Trains with each weight of the loss and prints a table: the share of the loss' weight that falls on pixels which the
photograph shows in focus (true circle of confusion below a pixel), and the PSNR of the all-in-focus rendering of the
training views in these pixels, in pixels where the photograph is out of focus (above two pixels), and of the test
views.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.errors import Status
from dofbench.dataset.dataset import Dataset
from dofbench.gaussians.exposure import render_view
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.render import rasterise
from dofbench.gaussians.trainer import Trainer
from dofbench.learning.rendered_surface import surface_disparity
from dofbench.running.method_cards import find_method

WEIGHTS = {
    "none": {"adaptation": "off"},
    "Psi (printed Eq. 13)": {"adaptation": "psi"},
    "1 - Psi (text, released code)": {"adaptation": "one_minus_psi"},
}
IN_FOCUS, OUT_OF_FOCUS = 1.0, 2.0  # px, radius of the true circle of confusion


@dataclass(frozen=True)
class Settings:
    """What to train on, and how long."""

    data: tyro.conf.Positional[Path]
    """Dataset with per-view lenses."""
    steps: int = 1500
    """Training steps."""
    seeds: int = 3
    """Seeds, from 0."""


def main(settings: Settings) -> None:
    """Print the table."""
    configure_threads()
    dataset = Dataset.load(settings.data)
    training_set = dataset.training_set()
    _, preset, _ = find_method("dofgaussian").preset(None)
    print("| weight of the loss | of it in focus | training views in focus [dB] | out of focus | test views |")
    print("| :--- | ---: | ---: | ---: | ---: |", flush=True)
    for name, change in WEIGHTS.items():
        rows = []
        for seed in range(settings.seeds):
            trainer = Trainer(training_set, GaussianOptions().with_overrides({**preset, **change}), seed)
            outcome = trainer.fit(Budget(steps=settings.steps), Unobserved())
            if outcome.status is not Status.OK:
                raise SystemExit(f"{name}, seed {seed}: {outcome.status}: {outcome.message}")
            rows.append(_measured(trainer, dataset))
        values = np.array(rows)
        spread = values.std(axis=0, ddof=1) if len(rows) > 1 else np.full(4, np.nan)
        mean = values.mean(axis=0)
        print(
            f"| {name} | {mean[0]:.0%} | " + " | ".join(f"{mean[i]:.2f} ± {spread[i]:.2f}" for i in (1, 2, 3)) + " |",
            flush=True,
        )


def _measured(trainer: Trainer, dataset: Dataset) -> tuple[float, float, float, float]:
    """(share of the weight in focus, PSNR in focus, PSNR out of focus, PSNR of the test views)."""
    weighed, sharp, blurred = [], [], []
    for index, view in enumerate(dataset.training_views()):
        error = _squared_error(trainer, dataset, view)
        depth = dataset.depth(view)
        known = depth > 0
        radius = np.abs(view.physical_lens.signed_radius(1 / np.where(known, depth, 1), view.camera.width))
        in_focus, out_of_focus = known & (radius < IN_FOCUS), known & (radius > OUT_OF_FOCUS)
        weight = _weight(trainer, view.camera, index)
        weighed.append((weight[in_focus].sum(), weight.sum()))
        sharp.append(error[in_focus])
        blurred.append(error[out_of_focus])
    tests = np.mean([_psnr(_squared_error(trainer, dataset, view)) for view in dataset.test_views()])
    on, total = np.sum(weighed, axis=0)
    return on / total, _psnr(np.concatenate(sharp)), _psnr(np.concatenate(blurred)), float(tests)


@torch.no_grad()
def _weight(trainer: Trainer, camera: Camera, index: int) -> np.ndarray:
    """(H, W): the weight of a training view's loss at the end of the training."""
    raster = rasterise(trainer.gaussians, camera, trainer.options.appearance)
    shot = Shot(camera, trainer.lenses.ranges[index], *trainer.lenses.forward(index))
    weight = trainer.options.adaptation.loss_weight(shot.out_of_focus(surface_disparity(raster.depth, raster.alpha)))
    return np.ones(raster.alpha.shape) if weight is None else weight.numpy()


def _squared_error(trainer: Trainer, dataset: Dataset, view) -> np.ndarray:
    image = render_view(trainer.gaussians, view.camera, trainer.options, lens=None).image
    return ((np.clip(image, 0, 1) - dataset.all_in_focus(view)) ** 2).mean(axis=-1)


def _psnr(squared: np.ndarray) -> float:
    return float(-10 * np.log10(squared.mean()))


if __name__ == "__main__":
    main(tyro.cli(Settings))
