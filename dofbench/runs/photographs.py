"""`dofbench run --photographs`: from a folder of photographs, or a video, to results, a page and a .ply in one command.

The stages are those of the commands of their own, `reconstruct`, `make-dataset`, `run` and `report`, with their
folders below OUT/photographs: what is finished isn't done again, and each can be looked at or replaced.
"""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from dofbench.errors import InputError
from dofbench.harness.methods import find_method
from dofbench.harness.settings import Run, parse_budget, parse_overrides
from dofbench.motion.settings import Reconstruct
from dofbench.scenes import load_scene
from dofbench.scenes.folders import image_files
from dofbench.scenes.loading import detect
from dofbench.synthesis.settings import MakeDataset

WIDTH = 504  # px: what two cores train on in minutes, and the size at which LLFF's scores are published
HOLD = 8     # every so many-th photograph is held back, to be predicted and scored

# Seconds on two cores of a shared machine (reports/poses, reports/photographs): another one may take half, or twice.
_FEATURES, _PAIR, _PLACED = 1.5, 0.03, 0.5  # a photograph, two compared, one placed
_NEIGHBOURS = 30                            # photographs that each is compared with, at most
_STEP, _STEP_PIXEL = 0.03, 4.5e-7           # a training step, and a pixel of it
_PRIOR_PIXEL, _FIT_PIXEL = 4e-6, 1.5e-4     # a pixel of a training view, and of a held-back one


def dataset_of_photographs(source: Path, out: Path, width: int | None, console: Console) -> Path | None:
    """The dataset of the photographs in `source`, made below `out`; None where no scene came of them.

    A folder that is a scene with poses and points already is taken as it is. Raises InputError for wrong input.
    """
    from dofbench.motion import reconstruct
    from dofbench.synthesis import make_dataset

    place = folder_of(source, out)
    scene = source
    if not _has_points(source):
        scene = place / "scene"
        _say(console, f"camera poses and points of {source}: {scene}")
        if not reconstruct(Reconstruct(source=source, out=scene)):
            return None
    views = load_scene(scene).views
    wide = min(width or WIDTH, min(view.camera.width for view in views))
    data = place / f"{place.name}-{wide}"
    _say(console, f"dataset of {len(views)} photographs, {wide} px wide, every {HOLD}th held back: {data}")
    make_dataset(MakeDataset(scene=str(scene), photographs="shallow", width=wide, hold=HOLD, out=data))
    return data


def folder_of(source: Path, out: Path) -> Path:
    """Where what is made of the photographs goes. Raises InputError when `source` isn't there."""
    if not source.exists():
        raise InputError("--photographs", f"no such folder or file: {source}", "a folder of photographs, or a video")
    return out / "photographs" / source.resolve().stem


def outlook(source: Path, runs: tuple[Run, ...], width: int | None) -> list[str]:
    """What will be done with the photographs, and about how long each part takes."""
    posed = _has_points(source)
    files = image_files(source) if source.is_dir() and not posed else ()
    count = len(load_scene(source).views) if posed else len(files) or Reconstruct(source=source, out=source).frames
    lines, total = [], 0.0
    if not posed:
        pairs = count * min(count - 1, 2 * _NEIGHBOURS) / 2
        seconds = count * (_FEATURES + _PLACED) + pairs * _PAIR
        total += seconds
        lines.append(f"camera poses of {count} photographs: about {_minutes(seconds)}")
    pixels = (width or WIDTH) ** 2 * 3 / 4
    for run in runs:
        seconds = _training_seconds(run, pixels) + count * pixels * (_PRIOR_PIXEL + _FIT_PIXEL / HOLD)
        total += seconds
        lines.append(f"{run.method}, seed {run.seed}: about {_minutes(seconds)}")
    return [*lines, f"together about {_minutes(total)} on two cores; half or twice that elsewhere"]


def _training_seconds(run: Run, pixels: float) -> float:
    entry = find_method(run.method)
    _, options, budget = entry.preset(run.preset, builtin=False)
    budget = parse_budget(run.budget) if run.budget is not None else budget
    steps = {**options, **parse_overrides(run.set)}.get("steps", 0)
    if budget is not None:
        steps = budget.steps or steps
    seconds = float(steps) * (_STEP + pixels * _STEP_PIXEL)
    return min(seconds, budget.seconds) if budget is not None and budget.seconds is not None else seconds


def _has_points(source: Path) -> bool:
    if not source.is_dir() or detect(source) is None:
        return False
    points = load_scene(source).points
    return points is not None and len(points) > 0


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, markup=False, soft_wrap=True)
