"""`dofbench run --photographs`: from a folder of photographs, or a video, to results, a page and a .ply in one command.

The stages are those of the commands `reconstruct`, `make-dataset`, `run` and `report`, each with a folder below
OUT/photographs. A finished stage isn't repeated, and each stage's output can be inspected or replaced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.progress import say
from dofbench.datasets.format.schema import MANIFEST
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.plan import choose
from dofbench.running.time_estimate import seconds_by_card
from dofbench.scenes import load_scene
from dofbench.scenes.loading import detect
from dofbench.scenes.reconstruction.kept_steps import RECORD
from dofbench.scenes.reconstruction.matching import LOOK_ALIKES
from dofbench.scenes.reconstruction.matching import choose as choose_matching
from dofbench.scenes.reconstruction.photograph_source import find_source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct

WIDTH = 504  # px: small enough to train in minutes on two cores, and the width at which LLFF's scores are published
HOLD = 8  # one photograph in HOLD is held out, to be predicted and scored

# Seconds on two cores of a shared machine (docs/own-photographs.md): other machines may take half or twice as long.
_PHOTOGRAPH, _MEGAPIXEL = 0.5, 2.5  # features, mapping and undistortion: per photograph, and per megapixel
_PAIR = 0.03  # matching two photographs
_FRAME_MEGAPIXEL = 0.015  # per megapixel of a video frame: decoding it and measuring its sharpness
_DATASET_MEGAPIXEL = 0.3  # per megapixel of a photograph of the dataset: resizing it
_COMPILING = "the first run on a machine compiles kernels besides, about a minute"


@dataclass(frozen=True)
class Own:
    """A user's photographs. kind: the form of the input; a "scene" has poses and points already. views: their number;
    for a video the largest possible one. size: (width, height) of the first one. items: photographs or frames that are
    read to obtain the views."""

    source: Path
    place: Path
    kind: Literal["photographs", "video", "poses", "scene"]
    views: int
    size: tuple[int, int]
    items: int = 0

    @property
    def scene(self) -> Path:
        """Where the scene is, or will be; scenes are called after their folders."""
        return self.source if self.kind == "scene" else self.place / self.place.name

    def dataset(self, width: int | None) -> Path:
        """Where the dataset is, or will be."""
        return self.place / f"{self.place.name}-{min(width or WIDTH, self.size[0])}"

    def reconstruction(self) -> Reconstruct:
        """The settings of the reconstruction."""
        return Reconstruct(source=self.source, out=self.scene)


def find_own(source: Path, out: Path) -> Own:
    """The photographs, video or scene in `source`; files made from it go below `out`.

    Raises InputError for a source that isn't there, isn't readable, or has too few photographs.
    """
    if not source.exists():
        raise InputError("--photographs", f"no such folder or file: {source}", "a folder of photographs, or a video")
    resolved = source.resolve()
    # A folder's name may have a dot in it; "trip.2025" and "trip.2026" are two.
    name = resolved.name if source.is_dir() else resolved.stem
    place = out / "photographs" / (name or "photographs")
    if source.is_dir() and detect(source) is not None:
        scene = load_scene(source)
        if scene.points is not None and len(scene.points) > 0:
            camera = scene.views[0].camera
            return Own(source, place, "scene", len(scene.views), (camera.width, camera.height))
    found = find_source(Reconstruct(source=source, out=place / place.name))
    return Own(source, place, found.kind, found.views, found.size, found.count)


def check_runs(runs: Sequence[RunSpec]) -> None:
    """Raise InputError for a method, preset or option that isn't possible, before minutes are spent on camera poses."""
    for run in runs:
        if run.inputs != "shallow":
            raise InputError(
                "--inputs",
                f"{run.inputs} with --photographs",
                "the photographs as they are; where all are sharp, --set lens=false disables the lens",
            )
        choose(_on_data(run)).check_options()


def dataset_of_photographs(own: Own, width: int | None, console: Console) -> Path | None:
    """The folder of the photographs' dataset, made if it doesn't exist; None if no scene could be reconstructed.

    A folder that is a scene with poses and points already is taken as it is. Raises InputError for wrong input.
    """
    from dofbench.datasets.synthesis import make_dataset
    from dofbench.scenes.reconstruction import reconstruct

    if own.kind != "scene":
        say(console, f"{_WHAT[own.kind]} of {own.source}: {own.scene}")
        if not reconstruct(own.reconstruction()):
            return None
    views = load_scene(own.scene).views
    wide = min(width or WIDTH, min(view.camera.width for view in views))
    data = own.dataset(wide)
    say(console, f"dataset of {len(views)} photographs, {wide} px wide, every {HOLD}th held out: {data}")
    make_dataset(MakeDataset(scene=str(own.scene), photographs="shallow", width=wide, hold=HOLD, out=data))
    return data


def outlook(own: Own, runs: Sequence[RunSpec], width: int | None) -> list[str]:
    """Lines that tell what will be done with the photographs, and about how long each part takes."""
    lines, total = [], 0.0
    what = f"{_WHAT[own.kind]} of {'at most ' if own.kind == 'video' else ''}{own.views} photographs"
    if own.kind == "scene":
        lines.append(f"{what}: those of the scene {own.source}")
    elif (own.scene / RECORD).is_file():
        lines.append(f"{what}: there already, {own.scene}")
    else:
        total += (seconds := _motion_seconds(own))
        lines.append(f"{what}: about {_minutes(seconds)}")
    megapixels = own.size[0] * own.size[1] / 1e6
    wide = min(width or WIDTH, own.size[0])
    pixels = wide**2 * own.size[1] / own.size[0]
    finished = (own.dataset(width) / MANIFEST).is_file()
    if not finished:
        total += (seconds := own.views * megapixels * _DATASET_MEGAPIXEL)
        lines.append(f"dataset, {wide} px wide: about {_minutes(seconds)}")
    held = -(-own.views // HOLD)
    for run in runs:
        choices = choose(_on_data(run))
        steps = {**choices.options, **choices.overrides}.get("steps")
        known_seconds = seconds_by_card(
            choices.entry.card,
            choices.budget,
            steps,
            view_pixels=pixels,
            train_views=own.views - held,
            test_views=held,
            fitted=True,
        )
        if known_seconds is None:
            lines.append(f"{run.method}, seed {run.seed}: time unknown")
            continue
        seconds = known_seconds
        total += seconds
        known = ", less if cached" if finished else ""
        lines.append(f"{run.method}, seed {run.seed}: about {_minutes(seconds)}{known}")
    return [*lines, f"together about {_minutes(total)} on two cores, half or twice that elsewhere; {_COMPILING}"]


def _motion_seconds(own: Own) -> float:
    largest = Reconstruct(source=own.source, out=own.scene).size
    raw = own.size[0] * own.size[1] / 1e6
    megapixels = raw * min(1.0, largest / max(own.size)) ** 2
    matching = choose_matching("auto", own.views, own.kind == "video")
    pairs = own.views * ((own.views - 1) / 2 if matching == "exhaustive" else LOOK_ALIKES)
    return own.views * (_PHOTOGRAPH + megapixels * _MEGAPIXEL) + pairs * _PAIR + own.items * raw * _FRAME_MEGAPIXEL


def _on_data(run: RunSpec) -> RunSpec:
    """The run with a dataset given, as for a user's own data, so that the method's default preset is chosen."""
    return replace(run, data=run.out)


_WHAT = {
    "photographs": "camera poses and points",
    "video": "frames, camera poses and points",
    "poses": "points, the poses being known,",
    "scene": "poses and points",
}


def _minutes(seconds: float) -> str:
    return f"{max(1, seconds):.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
