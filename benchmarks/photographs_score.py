"""Whether the protocol `photographs-v1` ranks methods as the ground truth does: runs.csv, ranks.csv and ranks.md.

    python benchmarks/photographs_score.py --data DATASET ... --out reports/photographs-score

Methods, presets and options of varying quality (`VARIANTS`) are trained for a few steps on each dataset, and scored
twice: by the ground truth (test views through their true lens, and all in focus), and by photographs-v1 as if it were
unknown. Their agreement is measured by Spearman's and Kendall's rank correlation over the variants, with the interval
of 95 % of resamplings of the variants: over all variants, and over those within 2 dB of the best by ground truth, which
are harder to distinguish.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.contracts import Method
from dofbench.core.errors import Status
from dofbench.core.files import write_text
from dofbench.core.images import from_8bit, to_8bit
from dofbench.dataset.dataset import Dataset
from dofbench.metrics import score_image
from dofbench.reporting.csv_writer import write_csv
from dofbench.reporting.markdown_writer import markdown_table
from dofbench.results.protocol import arithmetic_mean
from dofbench.running.method_cards import find_method
from dofbench.scoring.photograph_scores import prediction_scores
from dofbench.scoring.photographs.predict import predict
from dofbench.scoring.photographs.search import THOROUGH

STEPS = 500
# name -> (method, preset, options): variants of different quality.
VARIANTS: dict[str, tuple[str, str, dict[str, object]]] = {
    "mipsplatting": ("mipsplatting", "cpu", {}),
    "dofgaussian": ("dofgaussian", "cpu", {}),
    "a third of the steps": ("dofgaussian", "cpu", {"steps": STEPS // 3}),
    "a tenth of the steps": ("dofgaussian", "cpu", {"steps": STEPS // 10}),
    "preset smoke": ("dofgaussian", "smoke", {"steps": STEPS}),
    "preset paper, sparse prior": ("dofgaussian", "paper", {"depth_prior": "sparse"}),
    "lens frozen at A 0.5": ("dofgaussian", "cpu", {"lens_from": 1.0}),
    "lens frozen at A 0.05": ("dofgaussian", "cpu", {"lens_from": 1.0, "lens_init_aperture": 0.05}),
    "lens frozen at A 1.5": ("dofgaussian", "cpu", {"lens_from": 1.0, "lens_init_aperture": 1.5}),
    "one lens for all": ("dofgaussian", "cpu", {"lens_per": "scene"}),
    "no depth supervision": ("dofgaussian", "cpu", {"depth_weight": 0.0, "depth_prior": "sparse", "start_points": 0}),
    "no harmonics": ("dofgaussian", "cpu", {"sh_degree": 0}),
    "4 000 Gaussians": ("dofgaussian", "cpu", {"max_gaussians": 4000, "start_points": 0}),
    "lens ten times slower": ("dofgaussian", "cpu", {"lens_lr": 5e-4, "lens_lr_final": 1e-4}),
}
TRUE = ("psnr", "aif_psnr")
ESTIMATED = ("photo_psnr", "photo_ssim")
SCORES = (*TRUE, *ESTIMATED, "photo_blur_psnr")
FIELDS = ("dataset", "variant", *SCORES, "train_s", "fit_s", "views")
RESAMPLED = 2000
CLOSE = 2.0  # dB


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    data: tuple[Path, ...]
    """Datasets with true lenses and sharp photographs."""
    out: Path
    """Folder for runs.csv, ranks.csv and ranks.md; a row that is in runs.csv isn't measured again."""
    steps: int = STEPS
    """Training steps of the variants that don't set their own."""
    only_rank: bool = False
    """Only rank the rows of runs.csv, without further measurements."""


def trained(name: str, dataset: Dataset, steps: int) -> tuple[Method, float]:
    """(trained variant, seconds)."""
    method_id, preset, options = VARIANTS[name]
    entry = find_method(method_id)
    preset = preset if preset in entry.card.presets else entry.card.default_preset
    _, chosen, _ = entry.preset(preset)
    chosen = {**chosen, "steps": steps, **options}
    method, observer = entry.create(chosen, 0, "cpu"), Unobserved()
    outcome = method.fit(dataset.training_set("shallow"), Budget(steps=int(chosen["steps"])), observer)
    if outcome.status is not Status.OK:
        raise FloatingPointError(f"{name} on {dataset.name}: {outcome.status}: {outcome.message}")
    return method, observer.seconds()


def row_of(name: str, dataset: Dataset, steps: int) -> dict[str, object]:
    """One variant on one dataset: means over the test views. psnr of a variant without a lens compares its all-in-focus
    rendering with the shallow photograph, as it has no other."""
    method, seconds = trained(name, dataset, steps)
    learned = method.lens_estimates()
    cameras = {view.name: view.camera for view in dataset.training_views()}
    rows, spent = [], 0.0
    for view in dataset.test_views():
        photograph = dataset.image(view)
        sharp = from_8bit(to_8bit(method.render(view.camera, None).image))
        try:
            refocused = from_8bit(to_8bit(method.render(view.camera, view.physical_lens).image))
        except ValueError:
            refocused = sharp
        found = predict(method, view.camera, photograph, learned, THOROUGH, cameras=cameras)
        spent += found.seconds
        scores = prediction_scores(found, photograph)
        scores.setdefault("photo_blur_psnr", scores["photo_psnr"])
        rows.append(
            {
                "psnr": score_image(refocused, photograph, ["psnr"])["psnr"],
                "aif_psnr": score_image(sharp, dataset.all_in_focus(view), ["psnr"])["psnr"],
                **scores,
            }
        )
    means = {column: arithmetic_mean([row[column] for row in rows]) for column in SCORES}
    return {"dataset": dataset.name, "variant": name, **means, "train_s": seconds, "fit_s": spent, "views": len(rows)}


def rank_rows(rows: list[dict[str, str]]) -> Iterator[dict[str, object]]:
    """Rank correlation of every estimated score with every true one, per dataset, with its 95 % interval.

    Variants are resampled; a resampling with fewer than three different variants is drawn again.
    """
    from scipy.stats import kendalltau, spearmanr

    for dataset in dict.fromkeys(row["dataset"] for row in rows):
        every = [row for row in rows if row["dataset"] == dataset]
        for true, estimated, close in itertools.product(TRUE, ESTIMATED, (False, True)):
            best = max(float(row[true]) for row in every)
            own = [row for row in every if not close or float(row[true]) > best - CLOSE]
            if len(own) < 4:
                continue
            x = np.array([float(row[true]) for row in own])
            y = np.array([float(row[estimated]) for row in own])
            generator = np.random.default_rng(0)
            drawn = []
            while len(drawn) < RESAMPLED:
                chosen = generator.integers(len(own), size=len(own))
                if len(set(chosen)) > 2:
                    drawn.append((spearmanr(x[chosen], y[chosen])[0], kendalltau(x[chosen], y[chosen])[0]))
            low, high = np.nanpercentile(np.array(drawn), [2.5, 97.5], axis=0)
            yield {
                "dataset": dataset,
                "truth": true,
                "score": estimated,
                "over": f"within {CLOSE:g} dB" if close else "all",
                "variants": len(own),
                "spearman": spearmanr(x, y)[0],
                "spearman_low": low[0],
                "spearman_high": high[0],
                "kendall": kendalltau(x, y)[0],
                "kendall_low": low[1],
                "kendall_high": high[1],
            }


def markdown(rows: list[dict[str, str]], ranks: list[dict[str, object]]) -> str:
    """Both tables."""
    lines = [
        "# photographs-v1 beside the truth",
        "",
        "By `benchmarks/photographs_score.py`.",
        "",
        "## Rank correlation",
        "",
    ]
    lines += markdown_table(
        ["dataset", "truth", "score", "over", "variants", "Spearman", "95 %", "Kendall", "95 %"],
        [
            [
                *(str(one[key]) for key in ("dataset", "truth", "score", "over", "variants")),
                f"{one['spearman']:.2f}",
                f"{one['spearman_low']:.2f} to {one['spearman_high']:.2f}",
                f"{one['kendall']:.2f}",
                f"{one['kendall_low']:.2f} to {one['kendall_high']:.2f}",
            ]
            for one in ranks
        ],
        left=4,
    )
    for dataset in dict.fromkeys(row["dataset"] for row in rows):
        own = sorted((row for row in rows if row["dataset"] == dataset), key=lambda row: -float(row["photo_psnr"]))
        lines += ["", f"## {dataset}", "", f"{own[0]['views']} test views.", ""]
        lines += markdown_table(
            ["variant", *SCORES, "training, s", "fit, s"],
            [
                [
                    row["variant"],
                    *(f"{float(row[column]):.{4 if column == 'photo_ssim' else 2}f}" for column in SCORES),
                    f"{float(row['train_s']):.0f}",
                    f"{float(row['fit_s']):.0f}",
                ]
                for row in own
            ],
            left=1,
        )
    return "\n".join(lines) + "\n"


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of runs.csv; none if the file doesn't exist."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def main(settings: Settings) -> None:
    """Measure the missing rows, then rank."""
    configure_threads()
    runs = settings.out / "runs.csv"
    for folder in () if settings.only_rank else settings.data:
        dataset = Dataset.load(folder)
        for name in VARIANTS:
            rows = read_rows(runs)
            if any((row["dataset"], row["variant"]) == (dataset.name, name) for row in rows):
                continue
            row = row_of(name, dataset, settings.steps)
            write_csv(runs, FIELDS, [*read_rows(runs), row])
            print(row, flush=True)
    rows = read_rows(runs)
    ranks = list(rank_rows(rows))
    write_csv(settings.out / "ranks.csv", tuple(ranks[0]), ranks)
    write_text(settings.out / "ranks.md", markdown(rows, ranks))


if __name__ == "__main__":
    main(tyro.cli(Settings))
