"""How much could a lens win at all in predicting one aperture from another? across-limit.csv, of finished runs.

    python tests/bench/across_limit.py --data data/across --results results --out reports/photographs

Each sharper test photograph is blurred by the lens that was learned of its nearest training view, on the learned depth:
what that changes is the error that training photographs' blur, painted on the scene, would make by itself. A perfect
lens takes that error away and no other, so a method without a lens could come nearer by `most_gain` dB at most. Pixels
are those where the training photographs are most blurred, as in the protocol.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from dofbench.contracts import Method
from dofbench.defocus import defocus
from dofbench.errors import InputError, Status
from dofbench.harness.methods import find_method
from dofbench.harness.photographs import BLURRED, blurred_thirds
from dofbench.harness.result import RESULT_FILE, Result, read_result
from dofbench.images import read_image
from dofbench.reporting.tables import write_csv
from dofbench.synthesis.dataset import Dataset, DatasetView

FIELDS = ("seed", "view", "blur_psnr", "without_psnr", "circle_px", "most_gain")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    data: Path
    """The dataset, made with --train-f-number and --test-f-number."""
    results: Path
    """Folder of results: of every seed a run of dofgaussian and one of mipsplatting."""
    out: Path
    """Folder for across-limit.csv."""


def trained(result: Result, folder: Path) -> Method:
    """The method as it was saved."""
    method = find_method(result.spec.method).create(dict(result.spec.options), result.spec.seed, "cpu")
    method.load(folder / "model")
    return method


def blurred_as_in_training(method: Method, dataset: Dataset, view: DatasetView) -> tuple[np.ndarray, np.ndarray]:
    """(photograph through the lens of the nearest training view, circles of confusion in pixels)."""
    near = min((other for other in dataset.views if other.split == "train"),
               key=lambda other: float(np.linalg.norm(other.camera.centre - view.camera.centre)))
    depth = np.asarray(method.render(view.camera, None).depth)
    there = depth > 0
    disparity = np.where(there, 1 / np.where(there, depth, 1.0), (1 / depth[there]).min())
    circles = method.lens_estimates()[near.name].signed_radius(disparity, view.camera.width).astype(np.float32)
    image = defocus(torch.from_numpy(dataset.image(view)), torch.from_numpy(circles)).numpy()
    return image, np.abs(circles)


def rows(dataset: Dataset, seed: int, with_lens: Method, without: Path) -> list[dict[str, object]]:
    """One for each test view, and their mean. without: predictions of the method without a lens."""
    found, thirds = [], blurred_thirds(dataset)
    for view in (view for view in dataset.views if view.split == "test"):
        mask, photograph = thirds[view.name] == BLURRED, dataset.image(view)
        blurred, circles = blurred_as_in_training(with_lens, dataset, view)
        predicted = read_image(without / f"{view.name}.png")
        lost, whole = (float(np.square(image - photograph, dtype=np.float64)[mask].mean())
                       for image in (blurred, predicted))
        gain = 10 * math.log10(whole / (whole - lost)) if whole > lost else math.inf
        found.append({"seed": seed, "view": view.name, "blur_psnr": -10 * math.log10(lost),
                      "without_psnr": -10 * math.log10(whole), "circle_px": float(np.median(circles[mask])),
                      "most_gain": gain})
    means = {name: float(np.mean([row[name] for row in found])) for name in FIELDS[2:]}
    return [*found, {"seed": seed, "view": "mean", **means}]


def main(settings: Settings) -> None:
    """Measure every seed that has both runs."""
    dataset = Dataset.load(settings.data)
    runs = {}
    for file in sorted(settings.results.rglob(RESULT_FILE)):
        result = read_result(file)
        plain = not result.spec.overrides and result.status is Status.OK
        if plain and result.spec.dataset_checksum == dataset.checksum:
            runs[result.spec.method, result.spec.seed] = (result, file.parent)
    table = []
    for method, seed in runs:
        if method == "dofgaussian" and ("mipsplatting", seed) in runs:
            other = runs["mipsplatting", seed][1] / "predictions" / "across"
            table += rows(dataset, seed, trained(*runs[method, seed]), other)
            print(table[-1], flush=True)
    if not table:
        raise InputError(settings.results, "no seed with both runs", f"runs on {settings.data}")
    write_csv(settings.out / "across-limit.csv", FIELDS, table)


if __name__ == "__main__":
    main(tyro.cli(Settings))
