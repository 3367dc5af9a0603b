"""What Gaussians close to a camera cost views from places where no training photograph was taken: near-plane.csv, of
finished runs.

    python benchmarks/near_plane.py --data data/across --results results --out reports/photographs

Nothing keeps Gaussians from standing between a new camera and everything that the photographs show. Each test view is
rendered without a lens, and its PSNR with the photograph is computed without any fit: `psnr` with the near plane of
training, `half_psnr` and `whole_psnr` with one at half and the whole of the smallest depth at which any training view
sees a sparse point. distance: from the nearest training camera, scene units.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from finished_runs import RunsSettings, finished_runs

from dofbench.core.errors import InputError
from dofbench.dataset.dataset import Dataset
from dofbench.gaussians.gaussian_method import GaussianMethod
from dofbench.metrics import score_image
from dofbench.reporting.csv_writer import write_csv
from dofbench.running.load_run import load_run
from dofbench.scenes.visibility import visible

SHARES = {"psnr": 0.0, "half_psnr": 0.5, "whole_psnr": 1.0}
FIELDS = ("method", "seed", "view", "distance", "near", *SHARES)


def nearest_point(dataset: Dataset) -> float:
    """The smallest depth of a sparse point that a training view sees, scene units."""
    given = dataset.training_set("shallow")
    assert given.points is not None
    seen = [visible(given.points, view.camera, index).depth for index, view in enumerate(given.views)]
    return float(min(depth.min() for depth in seen if depth.size))


def rows(dataset: Dataset, folder: Path, nearest: float) -> Iterator[dict[str, object]]:
    """A row for each test view, and one for their mean."""
    method = load_run(folder).method
    assert isinstance(method, GaussianMethod)
    gaussians = method.gaussians
    usual, centres = gaussians.near, [view.camera.centre for view in dataset.training_views()]
    found = []
    for view in dataset.test_views():
        row: dict[str, object] = {"view": view.name, "near": usual}
        row["distance"] = min(float(np.linalg.norm(view.camera.centre - centre)) for centre in centres)
        for name, share in SHARES.items():
            gaussians.near = max(usual, share * nearest)
            picture = method.render(view.camera, None).image
            row[name] = score_image(picture, dataset.image(view), ["psnr"])["psnr"]
        found.append(row)
    means = {name: float(np.mean([row[name] for row in found])) for name in FIELDS[3:]}
    yield from [*found, {"view": "mean", **means}]


def main(settings: RunsSettings) -> None:
    """Measure every finished run on the dataset."""
    dataset = Dataset.load(settings.data)
    nearest, table = nearest_point(dataset), []
    for entry in finished_runs(settings.results, dataset):
        told = {"method": entry.spec.method, "seed": entry.spec.seed}
        table += [{**told, **row} for row in rows(dataset, entry.folder, nearest)]
        print(table[-1], flush=True)
    if not table:
        raise InputError(settings.results, "no finished run", f"runs on {settings.data}")
    write_csv(settings.out / "near-plane.csv", FIELDS, table)


if __name__ == "__main__":
    main(tyro.cli(RunsSettings))
