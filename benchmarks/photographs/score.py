"""Does the protocol of real photographs rank variants of methods as the truth does, on datasets of known lens?

    python -m benchmarks.photographs.score --data DATASET ... --models DIR --out reports/photographs/score.csv

Trains the variants (those in --models aren't trained again), and scores each twice: by the truth, with the test view's
lens and all in focus, and by the protocol, as if lens and all-in-focus image were unknown. Prints Spearman's rank
correlation over the variants of each dataset, with the interval of 95 % of resamplings of the variants. The protocol is
that of the code it is run on: photographs-v1 at commit 50cdad66.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from dofbench.core.budget import Budget
from dofbench.core.contracts import Method
from dofbench.core.errors import Status
from dofbench.core.files import write_csv, write_json
from dofbench.core.images import from_8bit, to_8bit
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.metrics import score_image
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import PHOTOGRAPH_COLUMNS, protocol_for
from dofbench.evaluation.scoring.photograph_scores import scored_photographs
from dofbench.methods.cards import find_method
from dofbench.running.observer import OneStep

STEPS = 250
OWN: dict[str, object] = {"lens_trials": ""}  # a lens whatever the checks would say
# name -> (method, preset, options): variants of different quality.
VARIANTS: dict[str, tuple[str, str, dict[str, object]]] = {
    "mipsplatting": ("mipsplatting", "cpu", {}),
    "dofgaussian": ("dofgaussian", "short", {}),
    "dofgs": ("dofgs", "cpu", {}),
    "deblurring3dgs": ("deblurring3dgs", "cpu", {}),
    "lensselect, no checks": ("lensselect", "cpu", OWN),
    "a third of the steps": ("lensselect", "cpu", {**OWN, "steps": STEPS // 3}),
    "a tenth of the steps": ("lensselect", "cpu", {**OWN, "steps": STEPS // 10}),
    "lens fixed at A 0.5": ("lensselect", "cpu", {**OWN, "lens_from": 1.0}),
    "lens fixed at A 0.05": ("lensselect", "cpu", {**OWN, "lens_from": 1.0, "lens_init_aperture": 0.05}),
    "lens fixed at A 1.5": ("lensselect", "cpu", {**OWN, "lens_from": 1.0, "lens_init_aperture": 1.5}),
    "shared lens": ("lensselect", "cpu", {**OWN, "lens_per": "scene"}),
    "no harmonics": ("lensselect", "cpu", {**OWN, "sh_degree": 0}),
}
TRUTH = ("psnr", "ssim", "aif_psnr", "aif_ssim")
CLOSE = 2.0  # dB: variants as near to the best one are also ranked by themselves


class _Unobserved(OneStep):
    """Lets a training run to its end."""

    def after_step(self, step: int, loss: float) -> bool:
        """Continue."""
        return True


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    data: tuple[Path, ...]
    """Datasets; those without a known lens are scored by the protocol alone."""
    models: Path
    """Folder of the trained variants."""
    out: Path
    """Table; rows that it has aren't measured again."""
    variants: tuple[str, ...] = tuple(VARIANTS)
    """Names of variants."""


def trained(folder: Path, name: str, dataset: Dataset) -> Method:
    """The variant, from its folder or newly trained."""
    method_id, preset, options = VARIANTS[name]
    chosen = {**find_method(method_id).preset(preset)[1], "steps": STEPS, **options}
    method = find_method(method_id).create(chosen, 0, "cpu")
    if (folder / "ok.json").is_file():
        method.load(folder)
        return method
    outcome = method.fit(dataset.training_set("shallow"), Budget(steps=int(chosen["steps"])), _Unobserved())
    if outcome.status is not Status.OK:
        raise FloatingPointError(f"{name} on {dataset.name}: {outcome.status}: {outcome.message}")
    folder.mkdir(parents=True, exist_ok=True)
    method.save(folder)
    write_json(folder / "ok.json", {"method": method_id, "options": chosen})
    return method


def scores_of(method: Method, dataset: Dataset) -> dict[str, float]:
    """Means over the test views. Without a lens, the all-in-focus rendering is compared with the shallow image too."""
    rows = []
    for scored in scored_photographs(method, dataset, PHOTOGRAPH_COLUMNS, no_lens="", quick=False):
        view, row = scored.view, dict(scored.scores)
        if view.physical_lens is not None and (truth := dataset.all_in_focus(view)) is not None:
            sharp = from_8bit(to_8bit(method.render(view.camera, None).image))
            try:
                refocused = from_8bit(to_8bit(method.render(view.camera, view.physical_lens).image))
            except ValueError:
                refocused = sharp
            row |= score_image(refocused, dataset.image(view), ["psnr", "ssim"])
            row |= {f"aif_{name}": value for name, value in score_image(sharp, truth, ["psnr", "ssim"]).items()}
        rows.append(row)
    return {column: float(np.mean([row[column] for row in rows])) for column in rows[0]}


def ranks(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of a Markdown table: dataset, protocol, truth, score, variants, Spearman, 95 %."""
    from scipy.stats import spearmanr

    groups = dict.fromkeys((row["dataset"], row["protocol"]) for row in rows if row.get("psnr"))
    for dataset, protocol in groups:
        every = [row for row in rows if (row["dataset"], row["protocol"]) == (dataset, protocol)]
        for true, score, close in [(t, f"photo_{s}", c) for c in (False, True) for t in ("psnr", "aif_psnr")
                                   for s in ("psnr", "ssim", "blur")]:  # fmt: skip
            if not all(row.get(score) for row in every):
                continue
            best = max(float(row[true]) for row in every)
            own = [row for row in every if not close or float(row[true]) > best - CLOSE]
            x, y = (np.array([float(row[column]) for row in own]) for column in (true, score))
            y *= 1 if COLUMNS[score].higher_is_better else -1
            drawn, generator = [], np.random.default_rng(0)
            while len(drawn) < 2000:
                chosen = generator.integers(len(own), size=len(own))
                if len({*x[chosen]}) > 2 and len({*y[chosen]}) > 2:
                    drawn.append(spearmanr(x[chosen], y[chosen])[0])
            low, high = np.percentile(drawn, [2.5, 97.5])
            over = f"within {CLOSE:g} dB" if close else "all"
            spearman = spearmanr(x, y)[0]
            cells = (dataset, protocol, true, score, over, len(own), f"{spearman:.2f}", f"{low:.2f} to {high:.2f}")
            yield f"| {' | '.join(map(str, cells))} |"


def columns_of(rows: list[dict[str, Any]]) -> list[str]:
    """All columns that one of the rows has."""
    return list(dict.fromkeys(("dataset", "protocol", "variant", *TRUTH, *(column for row in rows for column in row))))


def main(settings: Settings) -> None:
    """Measure what the table hasn't, and print the ranks."""
    protocol = protocol_for("shallow", photographs=PHOTOGRAPH_COLUMNS).id
    rows: list[dict[str, Any]] = []
    if settings.out.is_file():
        with settings.out.open(newline="") as file:
            rows = list(csv.DictReader(file))
    # Rows of the same protocol before it had all of its columns are measured again.
    rows = [row for row in rows if row["protocol"] != protocol or row.get(PHOTOGRAPH_COLUMNS[-1])]
    known = {(row["dataset"], row["protocol"], row["variant"]) for row in rows}
    for folder in settings.data:
        dataset = Dataset.load(folder)
        for name in settings.variants:
            if (folder.name, protocol, name) in known:
                continue
            method = trained(settings.models / folder.name / name.replace(" ", "_"), name, dataset)
            scores = {column: f"{value:.4f}" for column, value in scores_of(method, dataset).items()}
            rows.append({"dataset": folder.name, "protocol": protocol, "variant": name, **scores})
            write_csv(settings.out, columns_of(rows), rows)
            print(json.dumps(rows[-1]), flush=True)
    for line in ranks(rows):
        print(line)


if __name__ == "__main__":
    main(tyro.cli(Settings))
