"""The page of a user's own photographs: all-in-focus views beside the photographs, a film, and a few numbers.

Page, pictures, film and model lie in one folder, which can be moved or given away as it is.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_text, write_text
from dofbench.core.images import to_8bit, write_png
from dofbench.core.progress import Progress
from dofbench.datasets.format.dataset import Dataset, DatasetView
from dofbench.evaluation.results.result import MODEL_FOLDER
from dofbench.reporting.render import html
from dofbench.running.load_run import LoadedRun
from dofbench.running.model import renderer
from dofbench.running.usual_lens import focus_range, usual_opening
from dofbench.viewing import camera_paths
from dofbench.viewing.film import frames_of, render_frames, write_animation, write_video
from dofbench.viewing.lens_track import LensTrack, Track

PAGE, PICTURES, FILM, MODEL = "index.html", "pictures", "film", "model"
TRAINING_VIEWS = 4  # of which all-in-focus pictures are made, besides all test views
FRAMES, FILM_WIDTH, FPS = 72, 480, 24.0
_KEPT = ("gaussians.ply", "lenses.json", "colours.json")


@dataclass(frozen=True)
class Pair:
    """A photograph and the all-in-focus rendering of its view: files relative to the page. held_out: whether the
    method hasn't seen the photograph."""

    name: str
    held_out: bool
    photograph: str
    all_in_focus: str
    width: int
    height: int


def own_page(run: LoadedRun, folder: Path, report: Path, progress: Progress) -> Path:
    """Write the page of a finished run on photographs into `folder`; returns it. report: the page of all scores.

    Raises InputError for a run without a model or dataset.
    """
    dataset, method = run.dataset, run.method
    views = shown_views(dataset)
    pairs = []
    with progress.stage("all-in-focus pictures", len(views)) as advance:
        for number, view in enumerate(views, start=1):
            pairs.append(_pair(run, view, folder, number))
            advance(number)
    lensed = method.lens_estimates()
    film = _film(run, views[0], folder, lensed is not None, progress)
    (folder / MODEL).mkdir(parents=True, exist_ok=True)
    for name in _KEPT:
        if (run.folder / MODEL_FOLDER / name).is_file():
            shutil.copyfile(run.folder / MODEL_FOLDER / name, folder / MODEL / name)
    page = html(
        "photographs",
        title=dataset.name,
        method=run.result.spec.method,
        pairs=pairs,
        film=film,
        lens=lensed is not None,
        reason=_about_lens(run),
        facts=facts(run),
        model=f"{MODEL}/{_KEPT[0]}" if (folder / MODEL / _KEPT[0]).is_file() else "",
        report=_relative(report, folder),
    )
    write_text(folder / PAGE, page)
    return folder / PAGE


def shown_views(dataset: Dataset) -> list[DatasetView]:
    """All test views, and a few training views that are spread over the names."""
    training = dataset.training_views()
    chosen = np.unique(np.linspace(0, len(training) - 1, min(TRAINING_VIEWS, len(training))).round().astype(int))
    return [*dataset.test_views(), *(training[index] for index in chosen)]


def facts(run: LoadedRun) -> list[tuple[str, str]]:
    """The few numbers of the page: (name, value)."""
    scores, dataset = run.result.scores, run.dataset
    found = [("photographs", f"{len(dataset.training_views())} to train on, {len(dataset.test_views())} held out")]
    if "photo_psnr" in scores:
        ssim = f", SSIM {scores['photo_ssim']:.3f}" if "photo_ssim" in scores else ""
        found.append(("prediction of the held-out photographs", f"PSNR {scores['photo_psnr']:.2f} dB{ssim}"))
    if "photo_sharp_psnr" in scores:
        found.append(("the same without a lens", f"PSNR {scores['photo_sharp_psnr']:.2f} dB"))
    if reason := _about_lens(run):
        found.append(("is there a lens", reason))
    if "resolved" in scores:
        found.append(("pixels that some photograph shows sharp", f"{scores['resolved']:.0f} %"))
    if "train_s" in scores:
        found.append(("training", f"{scores['train_s']:.0f} s, {scores.get('steps', 0):.0f} steps"))
    return found


def _pair(run: LoadedRun, view: DatasetView, folder: Path, number: int) -> Pair:
    photograph, sharp = (f"{PICTURES}/{number:02d}-{what}.png" for what in ("photograph", "all-in-focus"))
    write_png(folder / photograph, run.dataset.image(view))
    image = run.method.render(view.camera, None).image
    write_png(folder / sharp, to_8bit(np.clip(np.nan_to_num(image), 0, 1)))
    return Pair(view.name, view.split == "test", photograph, sharp, view.camera.width, view.camera.height)


def _film(run: LoadedRun, start: DatasetView, folder: Path, lensed: bool, progress: Progress) -> str:
    """Render a focus pull on a spiral; returns its file relative to the page. Without a lens all is in focus."""
    method, dataset = run.method, run.dataset
    bounds = focus_range(method, dataset, start.camera)
    cameras = [view.camera for view in dataset.training_views()]
    path = camera_paths.spiral(
        camera_paths.alike(cameras, start.camera),
        1.0 / (bounds.q_min + 0.5 * bounds.extent),
        turns=1.0,
    )
    track = None
    if lensed:
        foci = [bounds.q_min + one * bounds.extent for one in (0.1, 0.9, 0.1)]
        track = LensTrack(Track.even([usual_opening(method, dataset, bounds)]), Track.even(foci))
    width = min(FILM_WIDTH, start.camera.width)
    frames = frames_of(lambda moment: camera_paths.resized_to(path(moment), width), track, FRAMES)
    place, model = folder / FILM, sha256_text(f"{run.result.key} {sorted(run.result.model.items())}")
    with progress.stage("film", len(frames)) as advance:

        def rendered() -> list[Path]:
            return render_frames(renderer(method), frames, place, model=model, progress=lambda _, n, __: advance(n))

        try:
            files = rendered()
        except InputError:  # frames of an earlier run
            shutil.rmtree(place)
            files = rendered()
    try:
        write_video(files, place / "film.mp4", fps=FPS)
    except InputError:  # no package av
        write_animation(files, place / "film.webp", fps=FPS)
        return f"{FILM}/film.webp"
    return f"{FILM}/film.mp4"


def _about_lens(run: LoadedRun) -> str:
    """Why training or the plan kept the lens, left it out, or decided nothing; "" without a reason."""
    for stage in run.result.plan.get("stages", []):
        if stage.get("name") == "lens":
            return str(stage.get("reason", ""))
    return run.result.left_out_stages.get("lens", "")


def _relative(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file, folder)).as_posix() if file.exists() else ""
