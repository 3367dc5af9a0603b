"""Scores of a Gaussian method over the steps of trainings of different length, on small copies of a dataset.

    python -m benchmarks.length.curves --data data/fern --method lensselect --preset gpu --steps 3000 10000 \
        --crop 0 60 90 150 --set lens_trials= start_points=15000 --label "all views" --out reports/length

A crop of each view makes a training short enough for one core, and keeps pixels, poses and the share of the scene that
few views see. Rows of a training that is in the file already are replaced.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet
from dofbench.core.files import write_csv
from dofbench.core.images import resize
from dofbench.core.similarity import psnr, ssim
from dofbench.datasets.format.dataset import Dataset
from dofbench.methods.cards import find_method
from dofbench.training.gaussians.gaussian_method import GaussianMethod

FILE = "curves.csv"
_SCORES = ("psnr", "ssim", "aif_psnr", "held_out_psnr", "held_out_ssim")
COLUMNS = ("dataset", "method", "label", "steps", "seed", "step", "gaussians", *_SCORES, "cpu_s", "end")
_POINTS = 12  # evenly over a training
_SCORED = 0.05  # share of the tiles, where a training holds out none

Crop = tuple[int, int, int, int]  # left, top, right, bottom, px


class Small:
    """A dataset's training set and test views, shrunk and cropped."""

    def __init__(self, folder: Path, shrink: int, crop: Crop | None):
        self._dataset = dataset = Dataset.load(folder)
        self._shrink, self._crop = shrink, crop
        self.tests = [(view, self._camera(view.camera)) for view in dataset.test_views()]
        whole = dataset.training_set()
        views = tuple(
            replace(view, camera=self._camera(view.camera), image=self._image(view.image)) for view in whole.views
        )
        points = whole.points
        if points is not None and crop is not None:
            inside = [view.camera.inside(view.camera.project(points.xyz)[0]) for view in views]
            points = points.kept(np.any(inside, axis=0))
        self.training_set = TrainingSet(views, points, whole.offset)

    def _camera(self, camera: Camera) -> Camera:
        if self._shrink > 1:
            camera = camera.resized(camera.width // self._shrink, camera.height // self._shrink)
        if self._crop is None:
            return camera
        left, top, right, bottom = self._crop
        return replace(camera, cx=camera.cx - left, cy=camera.cy - top, width=right - left, height=bottom - top)

    def _image(self, image: np.ndarray) -> np.ndarray:
        height, width = image.shape[:2]
        small = resize(image, width // self._shrink, height // self._shrink) if self._shrink > 1 else image
        left, top, right, bottom = self._crop or (0, 0, small.shape[1], small.shape[0])
        return np.ascontiguousarray(small[top:bottom, left:right])

    def scores(self, method: GaussianMethod) -> dict[str, float]:
        """Means over the test views: through the true lens, or without a lens where it is unknown, and all in focus."""
        found: dict[str, list[float]] = {}
        for view, camera in self.tests:
            lens = view.physical_lens if method.options.lens.lens else None
            image, truth = method.render(camera, lens).image.clip(0, 1), self._image(self._dataset.image(view))
            found.setdefault("psnr", []).append(psnr(image, truth))
            found.setdefault("ssim", []).append(ssim(image, truth))
            sharp = self._dataset.all_in_focus(view)
            if sharp is not None:
                image = method.render(camera, None).image.clip(0, 1)
                found.setdefault("aif_psnr", []).append(psnr(image, self._image(sharp)))
        return {column: float(np.mean(values)) for column, values in found.items()}


class Curve:
    """An observer that scores a training at even steps."""

    def __init__(self, small: Small, method: GaussianMethod, steps: int):
        self._small, self._method, self._every, self._steps = small, method, max(1, steps // _POINTS), steps
        self._start, self._scoring = time.process_time(), 0.0
        self.rows: list[dict[str, Any]] = []

    def seconds(self) -> float:
        """Processor seconds, scoring excluded."""
        return time.process_time() - self._start - self._scoring

    def after_step(self, step: int, loss: float) -> bool:
        """Score if it is time."""
        if step % self._every == 0 and step < self._steps:
            self.score(step)
        return step < self._steps

    def stage(self, name: str, done: int, total: int) -> None:
        """Nothing is shown of it."""

    def score(self, step: int, end: str = "") -> None:
        """Add a row."""
        seconds, begin = self.seconds(), time.process_time()
        trainer = self._method.trainer
        held_out = trainer.held_out_scores(_SCORED)
        row: dict[str, Any] = {
            "step": step,
            "gaussians": len(self._method.gaussians),
            **self._small.scores(self._method),
        }
        row |= {"held_out_psnr": held_out.psnr, "held_out_ssim": held_out.ssim, "cpu_s": seconds, "end": end}
        self.rows.append(row)
        self._scoring += time.process_time() - begin


def train(small: Small, method_id: str, options: dict[str, Any], steps: int, seed: int) -> list[dict[str, Any]]:
    """The rows of one training, the last of the model that is kept."""
    method = find_method(method_id).create(options, seed, "cpu")
    assert isinstance(method, GaussianMethod)
    curve = Curve(small, method, steps)
    outcome = method.fit(small.training_set, Budget(steps=steps), curve)
    reasons = [decision.reason for decision in outcome.decisions if decision.stage == "early_stopping"]
    curve.score(outcome.steps, reasons[0] if reasons else str(outcome.status))
    return curve.rows


def _write(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    key = ("dataset", "method", "label", "steps", "seed")
    new = {tuple(str(row[name]) for name in key) for row in rows}
    kept: list[dict[str, Any]] = []
    if file.is_file():
        with file.open(newline="") as stream:
            kept = [row for row in csv.DictReader(stream) if tuple(row[name] for name in key) not in new]
    text = [
        {name: f"{value:.5g}" if isinstance(value, float) else value for name, value in row.items()} for row in rows
    ]
    write_csv(file, COLUMNS, [*kept, *text])


def main() -> None:
    """Train at each length and with each seed, and write the rows after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of a dataset")
    parser.add_argument("--method", default="lensselect", help="a Gaussian method")
    parser.add_argument("--preset", default="gpu")
    parser.add_argument("--steps", type=int, nargs="+", default=[3000, 10000])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--shrink", type=int, default=1, help="how many times smaller along each side")
    parser.add_argument("--crop", type=int, nargs=4, metavar=("LEFT", "TOP", "RIGHT", "BOTTOM"))
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--label", default="", help="of these settings in the table")
    parser.add_argument("--out", type=Path, default=Path("reports/length"))
    asked = parser.parse_args()
    small = Small(asked.data, asked.shrink, tuple(asked.crop) if asked.crop else None)
    options = {**find_method(asked.method).preset(asked.preset)[1], **dict(one.split("=", 1) for one in asked.set)}
    asked.out.mkdir(parents=True, exist_ok=True)
    for seed in range(asked.seeds):
        for steps in asked.steps:
            key = {"dataset": asked.data.name, "method": asked.method, "label": asked.label}
            rows = train(small, asked.method, options, steps, seed)
            _write(asked.out / FILE, [{**key, "steps": steps, "seed": seed, **row} for row in rows])


if __name__ == "__main__":
    main()
