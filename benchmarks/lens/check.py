"""How often the decision whether there is a lens, and whether views share it, is wrong: CSVs in reports/lens.

    python -m benchmarks.lens.check --work DIR --scenes SCENES --out reports/lens [--seconds 3600]

Makes the datasets of `cases.py` in DIR, small ones, and trains on each case until preset cpu's A/B checks have decided:
one row of decisions.csv per case and length of training, written as soon as it is known; a case with a row isn't
measured again. With --cost, cases are trained to the end with a per-view lens, without a lens, and with a shared lens:
costs.csv has the cost of a wrong decision. `tables.py` sums up decisions.csv.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from benchmarks.lens.cases import FAINT, Case, cases, load, make_datasets
from benchmarks.lens.tables import write_tables
from dofbench.core.budget import Budget
from dofbench.core.contracts import Decision
from dofbench.core.errors import InputError
from dofbench.core.files import write_csv
from dofbench.core.similarity import psnr
from dofbench.datasets.format.dataset import Dataset
from dofbench.methods.cards import find_method
from dofbench.methods.stages.facts import facts_of
from dofbench.runtime.threads import configure_threads
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.trainer import Trainer
from dofbench.training.gaussians.trials import HELD_BACK

COLUMNS = (
    "case",
    "kind",
    "views",
    "steps",
    "lens",
    "true_circle",
    "share",
    "points_px",
    "tried",
    "gain",
    "error",
    "circle",
    "shared",
    "apart",
    "scene_gain",
    "scene_error",
    "exif_gain",
    "exif_error",
    "aperture_gain",
    "aperture_error",
    "prior_s",
    "trials_s",
    "seconds",
    "status",
)
COST_COLUMNS = ("case", "way", "steps", "held_back_psnr", "aif_psnr", "ms_a_step", "status")
# Trainings for the cost of decisions: a lens for each photograph, no lens, one aperture with a focus each, one lens.
WAYS: dict[str, dict[str, object]] = {
    "on": {"lens_per": "view"},
    "off": {"lens": False},
    "aperture": {"lens_per": "aperture"},
    "scene": {"lens_per": "scene"},
}
_PIXELS, _VIEWS = 0.95, 0.9  # the quantiles of `Trainer.widest_circle`


@dataclass(frozen=True)
class Settings:
    """What to measure, and the folders."""

    work: Path
    """Folder of the datasets."""
    out: Path
    """Folder of the tables."""
    scenes: Path | None = None
    """Folder of the real scenes; without it, no dataset is made."""
    only: str = ""
    """Scenes from which datasets are made, comma-separated; without it, all."""
    steps: int = 500
    """Length of the training whose decisions are measured; the training ends when they are made."""
    seconds: float = 0.0
    """Start no further case after so many seconds; 0 for no limit."""
    cases: str = ""
    """Names of cases, comma-separated; without it, all whose dataset is there."""
    cost: bool = False
    """Train to the end with each possible decision."""


def main(settings: Settings) -> None:
    """Measure what isn't in the tables yet, and sum up."""
    configure_threads()
    start = time.perf_counter()
    if settings.scenes is not None:
        make_datasets(settings.scenes, settings.work, lambda name: print(name, flush=True), settings.only)
    table, costs = settings.out / "decisions.csv", settings.out / "costs.csv"

    def late() -> bool:
        return bool(settings.seconds) and time.perf_counter() - start > settings.seconds

    asked = set(filter(None, settings.cases.split(",")))
    ready = [case for case in cases() if (settings.work / case.folder / "dataset.json").is_file()]
    keyed = [
        ({"case": case.name, "steps": str(settings.steps)}, case) for case in ready if not asked or case.name in asked
    ]
    if settings.cost:
        pairs = [({**key, "way": way}, case) for key, case in keyed for way in WAYS]
        fill(costs, COST_COLUMNS, pairs, lambda key, case: cost(case, key["way"], settings), late)
    else:
        fill(table, COLUMNS, keyed, lambda key, case: decided(case, settings), late)
    write_tables(settings.out, read(table))


def read(file: Path) -> list[dict[str, str]]:
    """The rows of a table; none if the file doesn't exist."""
    return list(csv.DictReader(file.open())) if file.is_file() else []


def fill(
    file: Path,
    columns: tuple[str, ...],
    wanted: Sequence[tuple[dict[str, str], Case]],
    measure: Callable[[dict[str, str], Case], dict[str, object]],
    late: Callable[[], bool],
) -> None:
    """Add the missing rows to a table, writing each at once, until `late()` is true. Rows are identified by their
    key."""
    rows = read(file)
    for key, case in wanted:
        if late():
            return
        if any(all(row[name] == value for name, value in key.items()) for row in rows):
            continue
        try:
            row = {**key, **measure(key, case)}
        except InputError as error:
            row = {**key, "kind": case.kind, "status": str(error)}
        rows.append({column: row.get(column) for column in columns})
        file.parent.mkdir(parents=True, exist_ok=True)
        write_csv(file, columns, rows)
        rows = read(file)
        print(", ".join(f"{name} {value}" for name, value in rows[-1].items() if value), flush=True)


def options(settings: Settings, **changes: object) -> GaussianOptions:
    """Preset cpu of DoF-Gaussian, shorter, with changes."""
    _, preset, _ = find_method("lensselect").preset("cpu", builtin=False)
    return GaussianOptions().with_overrides({**preset, "steps": settings.steps, **changes})


def decided(case: Case, settings: Settings) -> dict[str, object]:
    """The decisions of the trials on a case, together with the truth."""
    dataset, training_set, chosen = load(case, settings.work)
    circle = true_circle(case, dataset, chosen)
    lens = case.lens or ("faint" if circle < FAINT else "yes")
    blur = facts_of(training_set, one_lens=None).blur_px
    trainer = Trainer(training_set, options(settings, lens_trials="lens,share"), 0)
    clock = Clock(trainer)
    outcome = trainer.fit(Budget(steps=settings.steps), clock)
    return {
        "kind": case.kind,
        "views": len(chosen),
        "lens": lens,
        "true_circle": circle,
        "share": case.share or "",
        "points_px": blur,
        **_found(outcome.decisions, trainer.options.lens.lens_per),
        "prior_s": outcome.stages.get("depth prior"),
        "trials_s": outcome.stages.get("trials"),
        "seconds": clock.seconds(),
        "status": str(outcome.status),
    }


def _found(decisions: Sequence[Decision], lens_per: str) -> dict[str, object]:
    by_stage = {decision.stage: decision for decision in decisions}
    row: dict[str, object] = {}
    if lens := by_stage.get("lens"):
        row |= {
            "tried": "yes" if lens.runs else "no",
            "gain": lens.figures["lens gain"],
            "error": lens.figures["lens error"],
            "circle": lens.figures["circle"],
        }
    if share := by_stage.get("lens_per_view"):
        row |= {"shared": lens_per, **{name.replace(" ", "_"): value for name, value in share.figures.items()}}
    return row


def true_circle(case: Case, dataset: Dataset, chosen: Sequence[int]) -> float | None:
    """`Trainer.widest_circle` of the true lenses on the true depth, pixels; None if they are unknown."""
    if case.lens == "no":
        return 0.0
    views = [dataset.training_views()[i] for i in chosen]
    if any(view.physical_lens is None or not view.has_depth for view in views):
        return None
    widest = []
    for view in views:
        depth = dataset.depth(view)
        circles = np.abs(view.physical_lens.signed_radius(1 / depth[depth > 0], depth.shape[1]))
        widest.append(np.quantile(circles, _PIXELS))
    return float(np.quantile(widest, _VIEWS))


class Clock:
    """An observer that ends the training when the trainer has decided; without a trainer, never."""

    def __init__(self, trainer: Trainer | None = None):
        self._trainer, self._start = trainer, time.perf_counter()
        self._worked: list[float] = []

    def seconds(self) -> float:
        """Since the beginning."""
        return time.perf_counter() - self._start

    def worked(self) -> float:
        """Processor seconds from the first step to the last, which other work on the machine doesn't increase much."""
        return self._worked[-1] - self._worked[0] if self._worked else 0.0

    def after_step(self, step: int, loss: float) -> bool:
        """Whether to go on."""
        self._worked.append(time.process_time())
        return self._trainer is None or not self._trainer.decisions

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""


def cost(case: Case, way: str, settings: Settings) -> dict[str, object]:
    """Train to the end with one of WAYS; score held-back pixels, and the sharp test views if they are known."""
    dataset, training_set, _ = load(case, settings.work)
    trainer = Trainer(training_set, options(settings, lens_trials="", held_back=HELD_BACK, **WAYS[way]), 0)
    clock = Clock()
    outcome = trainer.fit(Budget(steps=settings.steps), clock)
    return {
        "held_back_psnr": trainer.held_out_scores().psnr,
        "aif_psnr": _all_in_focus(trainer, dataset, case.contrast),
        "ms_a_step": 1000 * clock.worked() / max(outcome.steps - 1, 1),
        "status": str(outcome.status),
    }


def _all_in_focus(trainer: Trainer, dataset: Dataset, contrast: float) -> float | None:
    found = []
    for view in dataset.test_views():
        truth = dataset.all_in_focus(view)
        if truth is not None:
            rendered = trainer.render(view.camera, None).image
            found.append(psnr(np.clip(rendered, 0, 1), (0.5 + contrast * (truth - 0.5)).astype(np.float32)))
    return float(np.mean(found)) if found else None


if __name__ == "__main__":
    main(tyro.cli(Settings))
