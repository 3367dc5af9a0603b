"""How much depth the stereo prior finds, by the blur of a surface in its sharpest photograph: a table for
reports/notes/priors.md.

    python benchmarks/stereo_blur.py DATASET ... [--coarser 0,1,2]

DATASET is a folder that make-dataset made of a scene with depth. A pixel's blur is the smallest radius of its circle of
confusion through any of the training views' lenses.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from dofbench.core.lens import COC_FRACTION
from dofbench.dataset.dataset import Dataset
from dofbench.learning.priors.stereo import stereo_depth

EDGES = (0.0, 0.5, 1.5, 3.0, np.inf)  # px of radius


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets with depth."""
    coarser: str = "0,1,2"
    """How many times to repeat at half the previous size, comma-separated."""


def main(settings: Settings) -> None:
    """Print the table."""
    print(
        "| dataset | sharpest radius (px) | share of the picture | coarser | pixels with depth | CoC error < 0.5 px |"
        " mean (px) |\n" + "|---" * 7 + "|"
    )
    for folder in settings.datasets:
        dataset = Dataset.load(folder)
        training_set = dataset.training_set("shallow")
        truth, sharpest = zip(*(_truth(dataset, view.name) for view in training_set.views), strict=True)
        truth, sharpest = np.stack(truth), np.stack(sharpest)
        for coarser in map(int, settings.coarser.split(",")):
            found = np.stack([one.depth for one in stereo_depth(training_set, coarser=coarser)])
            _print(dataset, truth, sharpest, coarser, found)


def _truth(dataset: Dataset, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Disparity of a view, NaN where unknown, and its least radius over the lenses of the training views, px."""
    depth = dataset.depth(name)
    with np.errstate(divide="ignore"):
        disparity = np.where(depth > 0, 1 / depth, np.nan)
    lenses = [dataset.lens(view).physical(dataset.disparity_range, depth.shape[1]) for view in dataset.training_views()]
    return disparity, np.min([np.abs(lens.signed_radius(disparity, depth.shape[1])) for lens in lenses], axis=0)


def _print(dataset: Dataset, truth: np.ndarray, sharpest: np.ndarray, coarser: int, found: np.ndarray) -> None:
    for low, high in itertools.pairwise(EDGES):
        region = (sharpest >= low) & (sharpest < high)
        if region.mean() < 0.005:
            continue
        known = region & (found > 0)
        error = COC_FRACTION * truth.shape[2] * np.abs(1 / found[known] - truth[known]) / dataset.disparity_range.extent
        print(
            f"| {dataset.name} | {low:g} to {high:g} | {100 * region.mean():.0f} % | {coarser} |"
            f" {100 * known.sum() / region.sum():.1f} % | {100 * (error < 0.5).mean():.1f} % | {error.mean():.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
