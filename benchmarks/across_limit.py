"""An upper limit of how much a lens can improve the prediction of one aperture from another: across-limit.csv, of
finished runs.

    python benchmarks/across_limit.py --data data/across --results results --out reports/photographs

Each sharper test photograph is blurred by the learned lens of its nearest training view, on the learned depth. The
change is the error that arises if the blur of the training photographs becomes part of the scene's colours; a perfect
lens would avoid it. `gain` is the improvement in dB of the picture predicted without a lens when this error is
subtracted from it, and `correlation` is the correlation of this error with the prediction's error. `most_gain` is the
improvement if the two errors were perfectly correlated: errors of these sizes can't give more. Only the pixels where
the training photographs are most blurred are used, as in the protocol.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
import tyro
from finished_runs import RunsSettings, finished_runs

from dofbench.core.contracts import Method
from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.dataset.dataset import Dataset, DatasetView
from dofbench.optics.defocus import defocus
from dofbench.reporting.csv_writer import write_csv
from dofbench.results.collecting import Entry
from dofbench.running.load_run import load_run
from dofbench.scoring.photograph_scores import BLURRED, blurred_thirds

FIELDS = ("seed", "view", "blur_psnr", "without_psnr", "circle_px", "correlation", "gain", "most_gain")


def trained(entry: Entry) -> Method:
    """The trained method, as the run saved it."""
    return load_run(entry.folder).method


def gains(predicted: np.ndarray, blurred: np.ndarray, photograph: np.ndarray) -> dict[str, float]:
    """The columns that compare the error of a prediction with that of a blur. All arguments are (N, 3), for the same
    pixels."""
    whole, lost = ((image - photograph).astype(np.float64) for image in (predicted, blurred))
    size, least = np.sqrt(np.square(whole).mean()), np.sqrt(np.square(lost).mean())
    left = np.sqrt(np.square(whole - lost).mean())
    return {
        "blur_psnr": -20 * math.log10(least),
        "without_psnr": -20 * math.log10(size),
        "correlation": float((whole * lost).mean() / (size * least)),
        "gain": 20 * math.log10(size / left),
        "most_gain": 20 * math.log10(size / (size - least)) if size > least else math.inf,
    }


def blurred_as_in_training(method: Method, dataset: Dataset, view: DatasetView) -> tuple[np.ndarray, np.ndarray]:
    """(photograph through the lens of the nearest training view, circles of confusion in pixels)."""
    near = min(
        (other for other in dataset.views if other.split == "train"),
        key=lambda other: float(np.linalg.norm(other.camera.centre - view.camera.centre)),
    )
    depth = np.asarray(method.render(view.camera, None).depth)
    there = depth > 0
    disparity = np.where(there, 1 / np.where(there, depth, 1.0), (1 / depth[there]).min())
    circles = method.lens_estimates()[near.name].signed_radius(disparity, view.camera.width).astype(np.float32)
    image = defocus(torch.from_numpy(dataset.image(view)), torch.from_numpy(circles)).numpy()
    return image, np.abs(circles)


def rows(dataset: Dataset, seed: int, with_lens: Method, without: Path) -> list[dict[str, object]]:
    """A row for each test view, and one for their mean. without: folder with the predictions of the method without a
    lens."""
    found, thirds = [], blurred_thirds(dataset)
    for view in dataset.test_views():
        mask = thirds[view.name] == BLURRED
        blurred, circles = blurred_as_in_training(with_lens, dataset, view)
        predicted = read_image(without / f"{view.name}.png")
        found.append(
            {
                "seed": seed,
                "view": view.name,
                "circle_px": float(np.median(circles[mask])),
                **gains(predicted[mask], blurred[mask], dataset.image(view)[mask]),
            }
        )
    means = {name: float(np.mean([row[name] for row in found])) for name in FIELDS[2:]}
    return [*found, {"seed": seed, "view": "mean", **means}]


def main(settings: RunsSettings) -> None:
    """Measure every seed that has a run of dofgaussian and one of mipsplatting."""
    dataset = Dataset.load(settings.data)
    runs = {
        (entry.spec.method, entry.spec.seed): entry
        for entry in finished_runs(settings.results, dataset)
        if not entry.spec.overrides
    }
    table = []
    for (method, seed), entry in runs.items():
        if method == "dofgaussian" and (other := runs.get(("mipsplatting", seed))) is not None:
            table += rows(dataset, seed, trained(entry), other.folder / "predictions" / "across")
            print(table[-1], flush=True)
    if not table:
        raise InputError(settings.results, "no seed with both runs", f"runs on {settings.data}")
    write_csv(settings.out / "across-limit.csv", FIELDS, table)


if __name__ == "__main__":
    main(tyro.cli(RunsSettings))
