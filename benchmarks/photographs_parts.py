"""How much each part of a photograph's model contributes, on pixels held back from training: parts.csv and
parts-table.md.

    python benchmarks/photographs_parts.py DATASET... --variants base,gain,affine --out reports/photographs

One row per dataset, variant and seed; rows that are in parts.csv aren't measured again. PSNR and SSIM are over the
held-back tiles of the training photographs, rendered with their learned lens and colour; if the dataset has sharp test
views, aif_psnr is their all-in-focus PSNR. NAME=PATH names a dataset. The training set can be changed by wrong poses or
moving things, inserted with a fixed seed.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Observer, TrainingSet
from dofbench.core.files import write_text
from dofbench.dataset.dataset import Dataset
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.learning.priors import Prior
from dofbench.metrics.psnr import psnr
from dofbench.reporting.csv_writer import write_csv
from dofbench.running.method_cards import find_method

SHARE = 0.1  # share of the tiles that is held back
WRONG, DEGREES = 3, 3.0  # number of views whose pose is made wrong, and by how many degrees they are turned
# Share of the views with a thing that the others don't show, and its side as a share of the image's height.
MOVING = {"moving": (0.3, 0.2), "moving-more": (0.6, 0.4)}
VARIANTS: dict[str, dict[str, object]] = {
    "base": {},
    "nolens": {"lens": False},
    "gain": {"colour_per_view": "gain"},
    "affine": {"colour_per_view": "affine"},
    "nolens-gain": {"lens": False, "colour_per_view": "gain"},
    "nolens-affine": {"lens": False, "colour_per_view": "affine"},
    "clipped": {"clipped_white": True},
    "gamma1.0": {"lens_gamma": 1.0},
    "gamma1.8": {"lens_gamma": 1.8},
    "gamma2.6": {"lens_gamma": 2.6},
    "nolens-views": {"lens": False, "outlier_views": True},
}
COLUMNS = (
    "dataset",
    "variant",
    "data",
    "seed",
    "steps",
    "psnr",
    "ssim",
    "psnr_worst_view",
    "aif_psnr",
    "left_out",
    "gaussians",
    "train_s",
)


@dataclass(frozen=True)
class Settings:
    """What to train, and where the table goes."""

    data: tyro.conf.Positional[tuple[str, ...]]
    """Datasets, NAME=PATH or PATH."""
    out: Path
    """Folder of parts.csv and parts-table.md."""
    variants: str = "base"
    """Variants, comma-separated: a name of the list, or option=value pairs joined by +."""
    harm: str = "none"
    """Change of the training set: none, poses, poses-removed, moving or moving-more."""
    inputs: Literal["shallow", "all-in-focus"] = "shallow"
    """Which of a dataset's photographs to train on."""
    seeds: str = "0"
    """Comma-separated."""
    steps: int = 1000
    """Training steps."""
    set: tuple[str, ...] = ()
    """Options of every run."""
    table: bool = False
    """Only write parts-table.md from parts.csv."""


def main(settings: Settings) -> None:
    """Train for the missing rows, and write the table after every row."""
    configure_threads()
    file = settings.out / "parts.csv"
    rows = list(csv.DictReader(file.open())) if file.is_file() else []
    for name, path in () if settings.table else (_named(entry) for entry in settings.data):
        dataset = Dataset.load(path)
        for seed in map(int, settings.seeds.split(",")):
            for variant in settings.variants.split(","):
                label = "+".join((variant, *settings.set))
                key = (name, label, settings.harm, str(seed), str(settings.steps))
                if key in {tuple(str(row[column]) for column in COLUMNS[:5]) for row in rows}:
                    continue
                measured = _measured(dataset, variant, settings, seed)
                rows.append(dict(zip(COLUMNS, (*key, *measured), strict=True)))
                settings.out.mkdir(parents=True, exist_ok=True)
                write_csv(file, COLUMNS, rows)
                print(rows[-1], flush=True)
    _write_table(rows, settings.out / "parts-table.md")


def _named(entry: str) -> tuple[str, Path]:
    name, equals, path = entry.partition("=")
    return (name, Path(path)) if equals else (Path(name).name, Path(name))


def _options(variant: str, settings: Settings) -> GaussianOptions:
    overrides = VARIANTS.get(variant)
    if overrides is None:
        overrides = dict(pair.split("=", 1) for pair in variant.split("+"))
    _, preset, _ = find_method("dofgaussian").preset("cpu", builtin=False)
    more = dict(pair.split("=", 1) for pair in settings.set)
    return GaussianOptions().with_overrides(
        {**preset, **overrides, **more, "steps": settings.steps, "held_back": SHARE, "lens_trials": ""}
    )


def _measured(dataset: Dataset, variant: str, settings: Settings, seed: int) -> Iterable[object]:
    training_set = _harmed(dataset.training_set(settings.inputs), settings.harm)
    trainer = _Trainer(training_set, _options(variant, settings), seed)
    start = time.perf_counter()
    trainer.fit(Budget(steps=settings.steps), Unobserved())
    spent = time.perf_counter() - start - trainer.stages["depth prior"]
    scores = trainer.held_back_scores()
    aif = [
        psnr(np.clip(trainer.render(view.camera, None).image, 0, 1), truth)
        for view in dataset.test_views()
        if (truth := dataset.all_in_focus(view)) is not None
    ]
    left_out = " ".join(sorted(training_set.views[index].name for index in trainer.left_out_views))
    return (
        f"{scores.psnr:.3f}",
        f"{scores.ssim:.4f}",
        f"{min(value for value, _ in scores.views.values()):.2f}",
        f"{np.mean(aif):.3f}" if aif else "",
        left_out,
        len(trainer.gaussians),
        f"{spent:.0f}",
    )


class _Trainer(Trainer):
    """Computes the depth prior, which no variant changes and which takes longest, only once per dataset and seed."""

    priors: ClassVar[dict[tuple, Prior | None]] = {}

    def _depth_prior(self, steps: int, observer: Observer) -> Prior | None:
        key = (self._seed, hash(b"".join(v.image.tobytes() + v.camera.world_to_camera.tobytes() for v in self.views)))
        if key not in self.priors:
            self.priors.clear()
            self.priors[key] = super()._depth_prior(steps, observer)
        return self.priors[key]


def _harmed(training_set: TrainingSet, harm: str) -> TrainingSet:
    random = np.random.default_rng(0)
    views = list(training_set.views)
    if harm in ("poses", "poses-removed"):
        chosen = random.choice(len(views), WRONG, replace=False)
        if harm == "poses-removed":
            kept = [index for index in range(len(views)) if index not in chosen]
            return TrainingSet(tuple(views[index] for index in kept), training_set.points.seen_by(kept))
        for index in chosen:
            views[index] = replace(views[index], camera=_turned(views[index].camera, random))
    elif harm in MOVING:
        share, size = MOVING[harm]
        for index in random.choice(len(views), math.ceil(share * len(views)), replace=False):
            image = views[index].image.copy()
            height, width = image.shape[:2]
            side = int(size * height)
            top, left = random.integers(height - side), random.integers(width - side)
            image[top : top + side, left : left + side] = random.uniform(size=3)
            views[index] = replace(views[index], image=image)
    return replace(training_set, views=tuple(views))


def _turned(camera: Camera, random: np.random.Generator) -> Camera:
    """The camera rotated by DEGREES about a random axis through its centre."""
    axis = random.normal(size=3)
    axis *= math.radians(DEGREES) / np.linalg.norm(axis)
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(DEGREES)
    turn = np.eye(4)
    turn[:3, :3] += math.sin(angle) * skew + (1 - math.cos(angle)) * skew @ skew
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _write_table(rows: list[dict], file: Path) -> None:
    """Write means over seeds, with the standard deviation if there are several."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((row["dataset"], row["data"], row["steps"], row["variant"]), []).append(row)
    lines = [
        "| dataset | training set | steps | variant | seeds | held-back PSNR [dB] | held-back SSIM | "
        "all-in-focus PSNR of test views [dB] | training without prior [s] |",
        "| :--- | :--- | ---: | :--- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for (dataset, data, steps, variant), some in groups.items():
        cells = [
            _spread(some, column, digits)
            for column, digits in (("psnr", 2), ("ssim", 3), ("aif_psnr", 2), ("train_s", 0))
        ]
        lines.append(f"| {dataset} | {data} | {steps} | {variant} | {len(some)} | " + " | ".join(cells) + " |")
    write_text(file, "\n".join(lines) + "\n")


def _spread(rows: list[dict], column: str, digits: int) -> str:
    values = [float(row[column]) for row in rows if row[column] not in ("", None)]
    if not values:
        return "–"
    spread = f" ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{np.mean(values):.{digits}f}{spread}"


if __name__ == "__main__":
    main(tyro.cli(Settings))
