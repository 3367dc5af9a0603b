"""How much could a lens win at all in predicting one aperture from another? across-limit.csv, of finished runs.

    python benchmarks/across_limit.py --data data/across --results results --out reports/photographs

Each sharper test photograph is blurred by the lens that was learned of its nearest training view, on the learned depth.
What that changes is the error that the training photographs' blur, painted on the scene, makes by itself; a perfect
lens takes it away. `gain` is what the picture predicted without a lens gains, dB, when just this is put back, and
`correlation` how alike both errors are. `most_gain` is what it would gain if they were alike in every pixel: two errors
of these sizes can't give more. Pixels are those where the training photographs are most blurred, as in the protocol.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from dofbench.core.contracts import Method
from dofbench.core.errors import InputError, Status
from dofbench.core.images import read_image
from dofbench.dataset.dataset import Dataset, DatasetView
from dofbench.optics.defocus import defocus
from dofbench.reporting.csv_writer import write_csv
from dofbench.results.collecting import Entry, collect
from dofbench.running.load_run import load_run
from dofbench.scoring.photograph_scores import BLURRED, blurred_thirds

FIELDS = ("seed", "view", "blur_psnr", "without_psnr", "circle_px", "correlation", "gain", "most_gain")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    data: Path
    """The dataset, made with --train-f-number and --test-f-number."""
    results: Path
    """Folder of results: of every seed a run of dofgaussian and one of mipsplatting."""
    out: Path
    """Folder for across-limit.csv."""


def trained(entry: Entry) -> Method:
    """The method as it was saved."""
    return load_run(entry.folder).method


def gains(predicted: np.ndarray, blurred: np.ndarray, photograph: np.ndarray) -> dict[str, float]:
    """What the error of a prediction and that of a blur have to do with each other. All (N, 3), of the same pixels."""
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
    """One for each test view, and their mean. without: predictions of the method without a lens."""
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


def main(settings: Settings) -> None:
    """Measure every seed that has both runs."""
    dataset = Dataset.load(settings.data)
    runs = {
        (entry.spec.method, entry.spec.seed): entry
        for entry in collect(settings.results).entries
        if entry.status is Status.OK and entry.spec.dataset_checksum == dataset.checksum and not entry.spec.overrides
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
    main(tyro.cli(Settings))
