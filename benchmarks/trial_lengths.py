"""Whether shorter trials decide as longer ones do, in trainings of the published length: trial-lengths.csv.

    python benchmarks/trial_lengths.py --data data/fern data/foliage-thin --out reports/notes

Trains each dataset by DoF-Gaussian's preset for a GPU until its trials are due (dofbench/gaussians/trials.py), and then
carries them out from that state once for each length. One row for each dataset, length and question, with the figures
that decide it and how long the trials took.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.contracts import Decision
from dofbench.dataset.dataset import Dataset
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.gaussians.trials import Trials
from dofbench.reporting.csv_writer import write_csv
from dofbench.running.method_cards import find_method

FIELDS = ("dataset", "steps", "start_points", "after", "length", "question", "runs", "gain", "error", "seconds")


@dataclass(frozen=True)
class Settings:
    """What is tried, and where the table goes."""

    data: tuple[Path, ...]
    """Datasets."""
    out: Path
    """Folder of trial-lengths.csv."""
    lengths: tuple[int, ...] = (50, 100, 200, 400, 900)
    """Of trials, steps."""
    steps: int = 30_000
    """Length of the training."""
    start_points: int = 25_000
    """Gaussians to start with; the preset has as many for each pixel at 504 x 378."""


class Several:
    """Stands for a training's trials: carries them out with every length, from the same state, and then has the
    training end."""

    def __init__(self, trainer: Trainer, lengths: Sequence[int]):
        self._trainer, self._lengths = trainer, lengths
        self._due = Trials(trainer, trainer.options)
        self.found: list[tuple[int, int, float, list[Decision]]] = []

    @property
    def open(self) -> bool:
        """Whether the trials are still to come."""
        return not self.found

    def due(self, step: int, progress: float) -> bool:
        """As of a training's own trials."""
        return self.open and self._due.due(step, progress)

    def decide(self, step: int, total: int, *others: object) -> tuple[int, list[Decision]]:
        """Fill `found` with (steps before, length, seconds, decisions) for each length. Two trials of a shorter and a
        longer length begin with the same photographs."""
        start = self._trainer.snapshot()
        for length in self._lengths:
            self._trainer.restore(start)
            trials = Trials(self._trainer, self._trainer.options)
            trials.length = lambda total, views, length=length: length  # type: ignore[method-assign]
            began = time.perf_counter()
            _, decisions = trials.decide(step, total, step / total)
            self.found.append((step, length, time.perf_counter() - began, decisions))
        return total, []


def main(settings: Settings) -> None:
    """Train, try, and write the table after every dataset."""
    configure_threads()
    rows = []
    for folder in settings.data:
        dataset = Dataset.load(folder)
        options = {
            **find_method("dofgaussian").preset("gpu")[1],
            "start_points": settings.start_points,
            "lens_trials": "lens,model",  # what a plan leaves open where lenses of known settings differ
            "colour_per_view": "off",
        }
        trainer = Trainer(dataset.training_set("shallow"), GaussianOptions.of(**options), 0)
        several = Several(trainer, settings.lengths)
        trainer._trials = several  # type: ignore[assignment]
        trainer.fit(Budget(steps=settings.steps), Unobserved())
        for after, length, seconds, decisions in several.found:
            for one in decisions:
                figures = list(one.figures.values())
                rows.append(
                    {
                        "dataset": folder.name,
                        "steps": settings.steps,
                        "start_points": settings.start_points,
                        "after": after,
                        "length": length,
                        "question": one.stage,
                        "runs": one.runs,
                        "gain": round(figures[0], 3),
                        "error": round(figures[1], 3),
                        "seconds": round(seconds, 1),
                    }
                )
        write_csv(settings.out / "trial-lengths.csv", FIELDS, rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
