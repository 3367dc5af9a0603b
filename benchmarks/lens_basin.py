"""From which initial values each parameterisation of a lens converges to the true lens: basin.csv, basin.md and
basin.png.

    python benchmarks/lens_basin.py --out reports/lens

With a known scene (`known`): sharp image and exact depth of the built-in scene's first view are given, and only the
lens is learned, from a grid of initial values and for several true lenses, against the photograph blurred by the same
renderer. This shows the problem without the influence of geometry. With an unknown scene (`joint`): Gaussians and
lenses are trained together from a coarser grid of initial values, on the dataset given by --data; errors are those of
the leaderboard.
"""

from __future__ import annotations

import csv
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from unobserved import Unobserved

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.errors import Status
from dofbench.core.files import replacing
from dofbench.core.images import resize
from dofbench.core.lens import DisparityRange, Lens
from dofbench.dataset.dataset import Dataset
from dofbench.gaussians.forward.forward_model import BlurOptions
from dofbench.gaussians.forward.scatter_blur import ScatterBlur, ScatterOptions
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.learning.image_losses import reconstruction
from dofbench.learning.lenses import LearnedLenses, LensOptions
from dofbench.metrics.lens_errors import lens_errors
from dofbench.reporting.figures import new_figure, save
from dofbench.running.method_cards import find_method
from dofbench.scenes import load_scene

ACTIVATIONS = ("relu", "log", "ends")
SHRUNK = 2  # factor by which the known scene's image is shrunk
FOUND = 0.02  # |A - A'| and |F - F'| below this count as converged to the true lens
TRUE = tuple(Lens(aperture, focus) for aperture in (0.5, 1.0) for focus in (0.2, 0.5, 0.8))
APERTURES = (0.03, 0.1, 0.25, 0.5, 1.0, 1.5, 2.0)
FOCI = (-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5)
FIELDS = ("part", "activation", "true_a", "true_f", "start_a", "start_f", "delta_a", "delta_f", "delta_r")


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder for basin.csv, basin.md and basin.png; a row that is in basin.csv isn't measured again."""
    steps: int = 200
    """Steps of learning the lens alone."""
    data: Path | None = None
    """Dataset for the joint training; without it that part is left out."""
    joint_steps: int = 600
    """Steps of the joint training."""
    joint_starts: str = "0.1:0.5,0.5:0.0,0.5:0.5,0.5:1.0,1.5:0.5"
    """Initial values of the joint training, A:F, comma-separated."""


def main(settings: Settings) -> None:
    """Measure the missing rows, and write the table and the picture."""
    configure_threads()
    settings.out.mkdir(parents=True, exist_ok=True)
    file = settings.out / "basin.csv"
    rows = list(csv.DictReader(file.open())) if file.is_file() else []
    done = {tuple(row[field] for field in FIELDS[:6]) for row in rows}
    for row in itertools.chain(_known(settings.steps, done), _joint(settings, done)):
        rows.append({field: str(value) for field, value in zip(FIELDS, row, strict=True)})
        with replacing(file) as temporary, temporary.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, FIELDS)
            writer.writeheader()
            writer.writerows(rows)
    _write_table(rows, settings.out / "basin.md")
    _plot(rows, settings.out / "basin.png")


def _key(part: str, activation: str, true: Lens | None, start: tuple[float, float]) -> tuple[str, ...]:
    lens = ("", "") if true is None else (str(true.aperture), str(true.focus))
    return part, activation, *lens, *(str(value) for value in start)


def _known(steps: int, done: set):
    scene = load_scene(content_folder("datasets") / "tabletop")
    view = scene.views[0]
    camera = view.camera.resized(view.camera.width // SHRUNK, view.camera.height // SHRUNK)
    image = torch.from_numpy(np.ascontiguousarray(resize(view.image(), camera.width, camera.height)))
    depth = view.depth()[SHRUNK // 2 :: SHRUNK, SHRUNK // 2 :: SHRUNK][: camera.height, : camera.width]
    disparity = torch.from_numpy((1 / depth).astype(np.float32))
    bounds = DisparityRange.of_disparity(disparity.numpy())
    for activation, true, start in itertools.product(ACTIVATIONS, TRUE, itertools.product(APERTURES, FOCI)):
        key = _key("known", activation, true, start)
        if key not in done:
            yield *key, *_learned_alone(image, disparity, camera, bounds, true, start, activation, steps)


def _learned_alone(image, disparity, camera, bounds: DisparityRange, true: Lens, start, activation, steps):
    options = LensOptions(
        lens_activation=activation,
        lens_init_aperture=start[0],
        lens_init_focus=start[1],
        lens_lr=2e-2,
        lens_lr_final=1e-3,
    )
    model = ScatterBlur(BlurOptions(), ScatterOptions())
    with torch.no_grad():
        lens = Shot(camera, bounds, true.aperture, -true.aperture * true.focus)
        photograph = model.spread(image, disparity, lens)
    lenses = LearnedLenses(1, bounds, options)
    for step in range(steps):
        shot = Shot(camera, bounds, *lenses.forward(0))
        loss = reconstruction(model.spread(image, disparity, shot), photograph, 0.2, None)
        if loss.requires_grad:
            loss.backward()
        if lenses.gradient() is None:  # exactly in focus everywhere, so the lens gets no gradient
            break
        lenses.step(0, step / steps)
    aperture, focus = lenses.aperture_and_focus(0)
    d = (disparity.numpy() - bounds.q_min) / (bounds.q_max - bounds.q_min)
    circles = true.aperture * np.abs(d - true.focus) - aperture * np.abs(d - focus)
    off = float(np.abs(circles).mean()) * Lens(1.0, 0.0).radius_per_disparity(camera.width)
    return abs(aperture - true.aperture), abs(focus - true.focus), off


def _joint(settings: Settings, done: set):
    if settings.data is None:
        return
    dataset = Dataset.load(settings.data)
    training_set = dataset.training_set("shallow")
    views = [view for view in dataset.views if view.split == "train"]
    starts = [tuple(float(value) for value in start.split(":")) for start in settings.joint_starts.split(",")]
    _, preset, _ = find_method("dofgaussian").preset(None, builtin=False)
    for activation, start in itertools.product(ACTIVATIONS, starts):
        key = _key("joint", activation, None, start)
        if key in done:
            continue
        options = GaussianOptions().with_overrides(
            {**preset, "lens_activation": activation, "lens_init_aperture": start[0], "lens_init_focus": start[1]}
        )
        trainer = Trainer(training_set, options, 0)
        outcome = trainer.fit(Budget(steps=settings.joint_steps), Unobserved())
        if outcome.status is not Status.OK:
            yield *key, float("nan"), float("nan"), float("nan")
            continue
        errors = lens_errors(
            {view.name: view.lens for view in views},
            trainer.lens_estimates(),
            dataset.disparity_range,
            views[0].camera.width,
            {view.name: dataset.depth(view) for view in views},
        )
        yield *key, errors.delta_a, errors.delta_f, errors.delta_r


def _number(row, field: str) -> float:
    """NaN for what a row of an earlier version lacks."""
    return float(row.get(field) or "nan")


def _write_table(rows, path: Path) -> None:
    """Write the table: the known scene by shares of converged starts, the joint training for each start."""
    lines = [
        f"Scene known, {len(TRUE)} true lenses; converged is within {FOUND} in A and in F:",
        "",
        "| learned | starts | converged | median δ_A | median δ_F | median δ_R, px | worst δ_A | worst δ_F | worst |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for activation in ACTIVATIONS:
        some = [row for row in rows if (row["part"], row["activation"]) == ("known", activation)]
        if some:
            a, f, r = (np.array([_number(row, field) for row in some]) for field in FIELDS[6:])
            found = int(((a < FOUND) & (f < FOUND)).sum())
            lines.append(
                f"| {activation} | {len(some)} | {found} ({found / len(some):.0%}) | {np.median(a):.4f} | "
                f"{np.median(f):.4f} | {np.median(r):.4f} | {a.max():.3f} | {f.max():.3f} | {r.max():.3f} |"
            )
    joint = [row for row in rows if row["part"] == "joint"]
    if joint:
        lines += [
            "",
            "Gaussians and lenses trained together, δ_A / δ_F / δ_R (px) over the training views:",
            "",
            "| start A | start F | " + " | ".join(ACTIVATIONS) + " |",
            "| ---: | ---: |" + " ---: |" * len(ACTIVATIONS),
        ]
        for start in dict.fromkeys((row["start_a"], row["start_f"]) for row in joint):
            cells = {
                row["activation"]: " / ".join(f"{_number(row, field):.3f}" for field in FIELDS[6:])
                for row in joint
                if (row["start_a"], row["start_f"]) == start
            }
            found = " | ".join(cells.get(activation, "–") for activation in ACTIVATIONS)
            lines.append(f"| {start[0]} | {start[1]} | {found} |")
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _plot(rows, path: Path) -> None:
    """Plot the share of the true lenses found from each start, with a panel for each parameterisation."""
    figure = new_figure(3.2 * len(ACTIVATIONS), 3.4)
    panels = figure.subplots(1, len(ACTIVATIONS), sharey=True)
    for axes, activation in zip(panels, ACTIVATIONS, strict=True):
        share = np.full((len(APERTURES), len(FOCI)), np.nan)
        for (i, aperture), (j, focus) in itertools.product(enumerate(APERTURES), enumerate(FOCI)):
            hits = [
                _number(row, "delta_a") < FOUND and _number(row, "delta_f") < FOUND
                for row in rows
                if (row["part"], row["activation"], row["start_a"], row["start_f"])
                == ("known", activation, str(aperture), str(focus))
            ]
            if hits:
                share[i, j] = np.mean(hits)
        picture = axes.imshow(share, vmin=0, vmax=1, origin="lower", cmap="viridis", aspect="auto")
        for (i, j), value in np.ndenumerate(share):
            if np.isfinite(value):
                axes.text(
                    j,
                    i,
                    f"{value:.0%}",
                    ha="center",
                    va="center",
                    fontsize=7,
                    color="black" if value > 0.5 else "white",
                )
        axes.set_xticks(range(len(FOCI)), [str(focus) for focus in FOCI])
        axes.set_yticks(range(len(APERTURES)), [str(aperture) for aperture in APERTURES])
        axes.set_xlabel("focus at the start")
        axes.set_title(activation, fontsize=10)
    panels[0].set_ylabel("aperture at the start")
    figure.colorbar(picture, ax=panels, label=f"true lenses found to {FOUND} in A and F")
    save(figure, path)


if __name__ == "__main__":
    main(tyro.cli(Settings))
