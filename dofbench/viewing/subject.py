"""What the viewer shows: a run, finished or in training, a dataset, or Gaussians in a PLY."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method, Rendering
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape, DisparityRange, PhysicalLens
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.schema import MANIFEST
from dofbench.evaluation.results.result import RESULT_FILE
from dofbench.evaluation.scoring.resolved import ResolvedCircles, photographs_of
from dofbench.running.load_run import LoadedRun, load_run
from dofbench.running.model import renderer
from dofbench.running.snapshots import found, read_snapshot
from dofbench.running.usual_lens import focus_range, learned_openings, opening_of, usual_opening
from dofbench.viewing import camera_paths

_FIELD = 50.0  # degrees, vertical field of view for Gaussians without cameras
_EXPECTED = "a run's folder (in training: with run --watch), a dataset's folder, or a .ply of Gaussians"


@dataclass(frozen=True, eq=False)
class Photograph:
    """An image of the scene by a known camera. split: "train" or "test". read: (H, W, 3), encoded."""

    name: str
    split: str
    camera: Camera
    read: Callable[[], np.ndarray] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Subject:
    """One scene that can be looked at.

    name: for people. scene: what must be equal for subjects shown together, "" for any. photographs: at least one
    camera to start from. up: (3,) unit vector. bounds: disparities that focus is set between. opening: half the width
    of the lens's opening to start with, scene units. f_scale: f-number times half opening, scene units, None where no
    f-number is known. render: None where nothing can be rendered from other cameras. version: grows when there is
    something new to render, as of a running training.
    """

    name: str
    scene: str
    photographs: tuple[Photograph, ...]
    up: np.ndarray
    bounds: DisparityRange
    opening: float
    f_scale: float | None = None
    render: Callable[[Camera, PhysicalLens | None, ApertureShape], Rendering] | None = None
    points: tuple[np.ndarray, np.ndarray] | None = None
    circles: Callable[[], ResolvedCircles] | None = None
    version: Callable[[], int] = lambda: 0

    @cached_property
    def resolved(self) -> ResolvedCircles | None:
        """For the map of resolved surfaces; None without learned lenses. The first time it takes a while."""
        return None if self.circles is None else self.circles()


def open_subjects(places: Sequence[Path]) -> list[Subject]:
    """The subjects in these places. Raises InputError for other things, and for several that are of several scenes."""
    subjects = [open_subject(place) for place in places]
    scenes = {subject.scene: place for subject, place in zip(subjects, places, strict=True) if subject.scene}
    if len(scenes) > 1:
        first, second, *_ = scenes.values()
        raise InputError(second, f"another scene than {first}", "results of one dataset, to show them together")
    if len(subjects) > 1 and any(subject.render is None for subject in subjects):
        raise InputError(places[0], "a dataset besides others", "one dataset alone, or results")
    return subjects


def open_subject(place: Path) -> Subject:
    """The subject in one place."""
    if place.suffix.lower() == ".ply" and place.is_file():
        return _of_splats(place)
    if place.name == RESULT_FILE or (place / RESULT_FILE).is_file():
        return _of_run(load_run(place))
    if found(place):
        return _of_training(place)
    if (place / MANIFEST).is_file():
        return _of_dataset(Dataset.load(place))
    raise InputError(place, "none of these" if place.exists() else "no such file or folder", _EXPECTED)


def _of_run(run: LoadedRun) -> Subject:
    return _of_method(run.method, run.dataset, f"{run.result.spec.method}, {run.result.spec.preset}")


class _Training:
    """The newest snapshot of a run in progress, and its model once it is finished."""

    def __init__(self, run: Path):
        self._run, self._lock = run, threading.Lock()
        self._newest, self._looked = found(run)[-1], time.monotonic()
        self._finished = False
        self.method, self.spec, self.data, self.step = read_snapshot(self._newest)

    def version(self) -> int:
        """Look for something newer, at most once a second; returns the step."""
        with self._lock:
            if not self._finished and time.monotonic() - self._looked > 1:
                self._looked = time.monotonic()
                self._look()
            return self.step

    def _look(self) -> None:
        try:
            if (self._run / RESULT_FILE).is_file():
                run = load_run(self._run, self.data)
                self.method, self.step, self._finished = run.method, self.step + 1, True
            elif (newest := found(self._run)[-1:]) and newest[0] != self._newest:
                self.method, _, _, self.step = read_snapshot(newest[0])
                self._newest = newest[0]
        except (InputError, OSError):  # being replaced: the next look will find it whole
            pass

    def render(self, camera: Camera, lens: PhysicalLens | None, shape: ApertureShape) -> Rendering:
        """Render the newest."""
        return renderer(self.method, shape)(camera, lens)


def _of_training(place: Path) -> Subject:
    training = _Training(place)
    name = f"{training.spec.method}, {training.spec.preset}, in training"
    still = _of_method(training.method, Dataset.load(training.data), name)
    return replace(still, render=training.render, version=training.version, circles=None)


def _of_method(method: Method, dataset: Dataset, name: str) -> Subject:
    photographs = _photographs(dataset)
    first = photographs[0].camera
    bounds = focus_range(method, dataset, first)
    cameras = {view.name: view.camera for view in dataset.training_views()}
    learned, openings = method.lens_estimates() or {}, learned_openings(method, dataset)
    numbers = {view.name: view.exif.f_number for view in dataset.training_views() if view.exif is not None}
    scales = [opening * number for name, opening in openings.items() if (number := numbers.get(name))]
    opening = usual_opening(method, dataset, bounds)
    return Subject(
        name=name,
        scene=dataset.checksum,
        photographs=photographs,
        up=camera_paths.mean_up([photograph.camera for photograph in photographs]),
        bounds=bounds,
        opening=opening if opening > 0 else opening_of(1.0, bounds, first),
        f_scale=float(np.median(scales)) if scales and np.median(scales) > 0 else None,
        render=lambda camera, lens, shape: renderer(method, shape)(camera, lens),
        circles=(lambda: ResolvedCircles(method, photographs_of(cameras, learned))) if learned else None,
    )


def _of_dataset(dataset: Dataset) -> Subject:
    photographs = _photographs(dataset)
    first = photographs[0].camera
    bounds = dataset.disparity_range or _range_of_points(dataset, first)
    lenses = [view.physical_lens.half_opening(view.camera) for view in dataset.views if view.physical_lens is not None]
    usual = opening_of(1.0, bounds, first)
    points = dataset.points
    return Subject(
        name=dataset.name,
        scene=dataset.checksum,
        photographs=photographs,
        up=camera_paths.mean_up([photograph.camera for photograph in photographs]),
        bounds=bounds,
        opening=float(np.median(lenses)) if lenses and np.median(lenses) > 0 else usual,
        points=None if points is None else (points.xyz.astype(np.float32), (points.rgb * 255).astype(np.uint8)),
    )


def _photographs(dataset: Dataset) -> tuple[Photograph, ...]:
    """The views, test views first: they are what a method hasn't been trained on."""

    def reader(name: str) -> Callable[[], np.ndarray]:
        return lambda: dataset.image(name)

    views = (*dataset.test_views(), *dataset.training_views())
    return tuple(Photograph(view.name, view.split, view.camera, reader(view.name)) for view in views)


def _range_of_points(dataset: Dataset, camera: Camera) -> DisparityRange:
    if dataset.points is None or not len(dataset.points):
        return DisparityRange(0.1, 1.0)
    _, depth = camera.project(dataset.points.xyz)
    return DisparityRange.of_disparity(1 / depth[depth > 0])


def _of_splats(file: Path) -> Subject:
    """Gaussians of any program, with a camera in front of them, y down as in COLMAP."""
    from dofbench.training.gaussians.gaussian_options import GaussianOptions
    from dofbench.training.gaussians.lens_renderer import LensRenderer
    from dofbench.training.gaussians.splats import read_splats

    gaussians = read_splats(file)
    model = LensRenderer(gaussians, GaussianOptions.of())
    means = gaussians.parameters["means"].numpy(force=True).astype(np.float64)
    middle = np.median(means, axis=0)
    reach = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.7)) or 1.0
    focal = 0.5 * 720 / np.tan(np.radians(_FIELD) / 2)
    pose = np.eye(4)
    pose[:3, 3] = -(middle - (0, 0, 1.5 * reach))
    camera = Camera(1080, 720, focal, focal, 540.0, 360.0, pose)
    bounds = DisparityRange(1 / (3 * reach), 1 / (0.5 * reach))
    start = Photograph("start", "train", camera, lambda: np.zeros((720, 1080, 3), np.float32))
    return Subject(
        name=file.stem,
        scene="",
        photographs=(start,),
        up=np.array([0.0, -1.0, 0.0]),
        bounds=bounds,
        opening=opening_of(1.0, bounds, camera),
        render=lambda camera, lens, shape: renderer(model, shape)(camera, lens),
    )
