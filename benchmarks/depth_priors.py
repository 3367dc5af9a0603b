"""The error of each depth prior, and its effect on training: tables for reports/notes/priors.md.

    PYTHONPATH=tests python benchmarks/depth_priors.py DATASET ... [--train-steps 1500 --seeds 0,1,2 --out DIR]

DATASET is a folder that make-dataset made of a scene with exact depth. The row `colmap` reads a workspace in COLMAP's
format that is written from that exact depth, so it shows the effect of perfect depth, not the accuracy of COLMAP. With
--out there is a training with each prior too, by the method's preset `cpu`; its results are stored there and reused.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from colmap_workspace import back_projected, write_workspace

from dofbench.core.budget import Budget
from dofbench.core.lens import COC_FRACTION
from dofbench.dataset.dataset import Dataset
from dofbench.learning.priors import PriorOptions, make_prior
from dofbench.results.result import read_result
from dofbench.results.run_spec import Run
from dofbench.running.one_run import run

SCORES = ("psnr", "aif_psnr", "disparity_error", "depth_rel", "delta_a", "delta_f", "delta_r")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets with exact depth."""
    priors: str = "none,sparse,stereo,network,tuned,colmap"
    """Priors, comma-separated. For training only: none, and PRIOR:N, which also starts from N points of the prior."""
    loss: str = "squared"
    """Form of Eq. 8."""
    inputs: Literal["shallow", "all-in-focus"] = "shallow"
    """Photographs from which the priors of the first table are made."""
    seeds: str = "0"
    """Seeds of the trainings, comma-separated."""
    train_steps: int = 1500
    """Length of training."""
    out: Path | None = None
    """Folder for results of training; without it, no training."""


def main(settings: Settings) -> None:
    """Print the tables."""
    print(
        "| dataset | prior | pixels with depth | within 1 % | 2 % | 5 % | median error | CoC error at A = 1: < 0.5 px"
        " | mean (px) | s |\n" + "|---" * 10 + "|",
        flush=True,
    )
    for folder in settings.datasets:
        for prior in settings.priors.split(","):
            if prior != "none" and ":" not in prior:
                _measure(Dataset.load(folder), prior, settings)
    if settings.out is None:
        return
    print(
        "\n| dataset | prior | "
        + " | ".join(SCORES)
        + " | training (s) | of it prior |\n"
        + "|---" * (len(SCORES) + 4)
        + "|",
        flush=True,
    )
    for folder in settings.datasets:
        for prior in settings.priors.split(","):
            _train(folder, prior, settings)


def _measure(dataset: Dataset, prior: str, settings: Settings) -> None:
    training_set = dataset.training_set(settings.inputs)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        options = {"depth_prior": prior, "depth_prior_loss": settings.loss, **_files(dataset, prior, Path(folder))}
        start = time.perf_counter()
        made = make_prior(training_set, PriorOptions(**options), seed=0, steps=10**9)
        seconds = time.perf_counter() - start
    for index, view in enumerate(training_set.views):
        samples = made.samples(index, view.camera)
        truth = dataset.depth(view.name)[samples.rows.numpy(), samples.columns.numpy()]
        known = truth > 0
        found, truth = samples.depth.numpy()[known], truth[known]
        error = np.abs(found / truth - 1)
        radius = COC_FRACTION * view.camera.width * np.abs(1 / found - 1 / truth) / dataset.disparity_range.extent
        shares = [len(samples.depth) / (view.camera.width * view.camera.height)]
        shares += [(error < share).mean() for share in (0.01, 0.02, 0.05)]
        rows.append([*shares, np.median(error), (radius < 0.5).mean(), radius.mean()])
    *shares, mean = np.mean(rows, axis=0)
    print(
        f"| {dataset.name} | {prior} | "
        + " | ".join(f"{100 * share:.1f} %" for share in shares)
        + f" | {mean:.2f} | {seconds:.0f} |",
        flush=True,
    )


def _train(folder: Path, prior: str, settings: Settings) -> None:
    dataset = Dataset.load(folder)
    workspace = settings.out / "workspaces" / dataset.name
    source, _, start = prior.partition(":")
    chosen = ["depth_weight=0"] if prior == "none" else [f"depth_prior={source}", f"start_points={start or 0}"]
    chosen += [f"{key}={value}" for key, value in _files(dataset, source, workspace).items()]
    rows = []
    for seed in settings.seeds.split(","):
        end = run(
            Run(
                method="dofgaussian",
                data=folder,
                preset="cpu",
                budget=Budget(steps=settings.train_steps),
                set=tuple(chosen),
                seed=int(seed),
                out=settings.out,
            )
        )
        result = read_result(end.folder / "result.json")
        rows.append(
            [
                *(result.scores.get(score, np.nan) for score in SCORES),
                result.stages["train"].wall,
                result.method_stages.get("depth prior", 0.0),
            ]
        )
    mean, spread = np.mean(rows, axis=0), np.std(rows, axis=0)
    # Errors of depth are left out if the dataset's depth isn't exact.
    cells = [
        f"{value:.4g} ± {around:.2g}" if np.isfinite(value) else "–"
        for value, around in zip(mean[:-2], spread[:-2], strict=True)
    ]
    print(f"| {dataset.name} | {prior} | {' | '.join(cells)} | {mean[-2]:.0f} | {mean[-1]:.1f} |", flush=True)


def _files(dataset: Dataset, prior: str, folder: Path) -> dict[str, str]:
    """The option for the workspace that a prior reads, which is written from exact depth."""
    if prior != "colmap":
        return {}
    views = dataset.training_views()
    if not (folder / "fused.ply").is_file():
        depths = [dataset.depth(view) for view in views]
        fused = np.concatenate([back_projected(view.camera, depth) for view, depth in zip(views, depths, strict=True)])
        folder.mkdir(parents=True, exist_ok=True)
        write_workspace(folder, [view.name for view in views], [view.camera for view in views], depths, fused)
    return {"depth_prior_workspace": str(folder)}


if __name__ == "__main__":
    main(tyro.cli(Settings))
