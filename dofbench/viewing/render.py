"""`dofbench render`: a film of a run's trained scene."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method
from dofbench.core.errors import InputError, unknown
from dofbench.core.files import sha256_text
from dofbench.core.lens import ApertureShape, DisparityRange
from dofbench.core.progress import Terminal, say
from dofbench.datasets.format.dataset import Dataset, DatasetView
from dofbench.running.load_run import load_run
from dofbench.running.model import renderer
from dofbench.running.usual_lens import focus_range, opening_of, usual_opening
from dofbench.viewing import camera_paths
from dofbench.viewing.film import frames_of, render_frames, write_animation, write_video
from dofbench.viewing.keyframes import film_of, read_keyframes
from dofbench.viewing.lens_track import LensTrack, Track
from dofbench.viewing.render_options import Render

VIDEO, ANIMATION = "film.mp4", "film.webp"


def render(settings: Render) -> Path:
    """Render the film; returns the video, or the folder of frames without one.

    Raises InputError for a run without a model or dataset, an unknown view, and frames of another film in the folder.
    """
    run = load_run(settings.result)
    method, dataset = run.method, run.dataset
    start = _first_view(settings, dataset)
    path, track = _plan(settings, method, dataset, start)
    width = settings.width or start.camera.width
    frames = frames_of(lambda moment: camera_paths.resized_to(path(moment), width), track, settings.frames)
    shape = ApertureShape(settings.blades, math.radians(settings.rotation))
    with Terminal().stage("frames", len(frames)) as advance:
        files = render_frames(
            renderer(method, shape),
            frames,
            settings.out,
            model=sha256_text(f"{run.result.key} {sorted(run.result.model.items())} {shape}"),
            kind="exr" if settings.format == "exr" else "png",
            depth=settings.depth,
            progress=lambda _, done, __: advance(done),
        )
    made = settings.out
    if settings.format == "mp4":
        made = settings.out / VIDEO
        write_video(files, made, fps=settings.fps)
    elif settings.format == "webp":
        made = settings.out / ANIMATION
        write_animation(files, made, fps=settings.fps)
    say(Console(), str(made))
    return made


def _plan(
    settings: Render, method: Method, dataset: Dataset, start: DatasetView
) -> tuple[camera_paths.Path, LensTrack]:
    """Camera path and lens. start: the view of --view."""
    if settings.keyframes is not None:
        return film_of(read_keyframes(settings.keyframes), start.camera)
    bounds = focus_range(method, dataset, start.camera)
    track = _track(settings, method, dataset, bounds)
    focused = bounds.q_min + settings.focus[0] * bounds.extent
    if settings.follow is not None:
        share = settings.follow[0], settings.follow[1]
        point = point_at(start.camera, method.render(start.camera, None).depth, share)
        track = replace(track, focus=point)
        focused = 1.0 / float(start.camera.project(point[None])[1][0])
    return _path(settings, dataset, start, 1.0 / max(focused, bounds.q_min)), track


def point_at(camera: Camera, depth: np.ndarray, share: tuple[float, float]) -> np.ndarray:
    """(3,) point seen at `share` of width and height, from z-depth (H, W). Raises InputError where nothing is there."""
    column, row = share[0] * camera.width, share[1] * camera.height
    at = min(int(row), camera.height - 1), min(int(column), camera.width - 1)
    z = float(depth[at])
    if not z > 0:
        raise InputError("point", f"nothing at {share[0]:g},{share[1]:g}", "a point where depth is rendered")
    right, down = camera.rays(column, row)
    return np.asarray((camera.camera_to_world @ np.array([right * z, down * z, z, 1.0]))[:3])


def _track(settings: Render, method: Method, dataset: Dataset, bounds: DisparityRange) -> LensTrack:
    """Focus and aperture in scene units, from the units of the disparity range."""
    openings = [usual_opening(method, dataset, bounds)]
    if settings.aperture is not None:
        first = dataset.training_views()[0].camera
        openings = [opening_of(one, bounds, first) for one in settings.aperture]
    foci = [bounds.q_min + one * bounds.extent for one in settings.focus]
    return LensTrack(Track.even(openings, settings.ease), Track.even(foci, settings.ease))


def _path(settings: Render, dataset: Dataset, start: DatasetView, depth: float) -> camera_paths.Path:
    """The camera path. depth: of what is in focus first, scene units."""
    cameras = [view.camera for view in dataset.training_views()]
    match settings.path:
        case "training":
            return camera_paths.along(cameras)
        case "spiral":
            return camera_paths.spiral(camera_paths.alike(cameras, start.camera), depth)
        case "orbit":
            return camera_paths.orbit(cameras)
        case "dolly":
            return camera_paths.dolly(start.camera, depth / 2)
        case "dolly-zoom":
            return camera_paths.dolly(start.camera, depth / 2, held_depth=depth)
        case "still":
            return camera_paths.along([start.camera])


def _first_view(settings: Render, dataset: Dataset) -> DatasetView:
    views = {view.name: view for view in (*dataset.test_views(), *dataset.training_views())}
    if settings.view is None:
        return next(iter(views.values()))
    if settings.view not in views:
        raise unknown("--view", settings.view, views)
    return views[settings.view]
