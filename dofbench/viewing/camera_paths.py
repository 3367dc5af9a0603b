"""Camera paths of films: a camera for each moment from 0 to 1, from the cameras of a scene.

Paths are functions of the scene's cameras alone, so the same film is made of every method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import Camera

Path = Callable[[float], Camera]  # of a moment, 0 to 1


def along(cameras: Sequence[Camera], moments: Sequence[float] | None = None, *, straight: bool = False) -> Path:
    """Pass the cameras one after the other: positions and framing on a smooth curve, rotations interpolated.

    moments: at which each is passed, ascending from 0 to 1; None for moments in proportion to the way between them, so
    that the speed is even. straight: with straight lines in between. Focal lengths are interpolated in proportion, not
    in pixels; image size and principal point are the first camera's. Raises ValueError for no camera or other moments.
    """
    from scipy.interpolate import PchipInterpolator, make_interp_spline
    from scipy.spatial.transform import Rotation, Slerp

    first = _required(cameras)
    if len(cameras) == 1:
        return lambda moment: first
    places = np.stack([camera.centre for camera in cameras])
    times = _moments(places) if moments is None else np.asarray(moments, dtype=np.float64)
    if len(times) != len(cameras) or times[0] != 0 or times[-1] != 1 or (np.diff(times) <= 0).any():
        raise ValueError(f"moments: expected {len(cameras)}, ascending from 0 to 1, found {times.tolist()}")
    turns = Slerp(times, Rotation.from_matrix([camera.camera_to_world[:3, :3] for camera in cameras]))
    zooms = np.log([[camera.fx / camera.width, camera.fy / camera.height] for camera in cameras])
    # Monotone between the zooms, so that a zoom doesn't overshoot.
    zoom = PchipInterpolator(times, zooms)
    place = make_interp_spline(times, places, k=1 if straight else min(3, len(cameras) - 1))

    def camera(moment: float) -> Camera:
        at = min(max(moment, 0.0), 1.0)
        across, down = np.exp(zoom(at))
        placed = _placed(first, place(at), turns(at).as_matrix())
        return replace(placed, fx=float(across) * first.width, fy=float(down) * first.height)

    return camera


def spiral(cameras: Sequence[Camera], target_depth: float, *, turns: float = 2.0, size: float = 0.5) -> Path:
    """A spiral about the mean of the cameras, looking at one point; it ends where it began.

    cameras: that look the same way (`alike`). target_depth: scene units, of the point on the mean camera's axis, where
    the cameras' axes don't meet in one (`looked_at`). size: of the spiral, in units of the 80th percentile of the
    cameras' distances along each axis of the mean camera. turns: rounds, of which the last ends at the start. Source:
    the paths of LLFF (Mildenhall et al., 2019), which look at a plane.
    """
    middle = mean_camera(cameras)
    axes = middle.camera_to_world[:3, :3]
    offsets = np.stack([camera.centre - middle.centre for camera in cameras]) @ axes
    reach = size * np.percentile(np.abs(offsets), 80, axis=0)
    target = looked_at(cameras)
    if (target - middle.centre) @ axes[:, 2] < 2 * np.abs(offsets).max():  # the axes are parallel, or go apart
        target = middle.centre + target_depth * axes[:, 2]

    def camera(moment: float) -> Camera:
        angle = 2 * math.pi * turns * moment
        local = reach * np.array([math.cos(angle), math.sin(angle), math.sin(angle / 2)])
        return looking_at(middle, middle.centre + axes @ local, target, -axes[:, 1])

    return camera


def alike(cameras: Sequence[Camera], camera: Camera, degrees: float = 30.0) -> list[Camera]:
    """`camera`, and those that look in its direction, to so many degrees."""
    forward = camera.camera_to_world[:3, 2]
    least = math.cos(math.radians(degrees))
    return [camera, *(one for one in cameras if one.camera_to_world[:3, 2] @ forward >= least)]


def orbit(cameras: Sequence[Camera], target: np.ndarray | None = None, *, turns: float = 1.0) -> Path:
    """A circle about `target`, (3,), that looks at it, at the cameras' mean distance and height above it.

    target: None for the point that the cameras look at (`looked_at`). It starts near the first camera. turns: rounds;
    a negative number goes round the other way.
    """
    first = _required(cameras)
    centre = looked_at(cameras) if target is None else np.asarray(target, dtype=np.float64)
    up = mean_up(cameras)
    away = np.stack([camera.centre for camera in cameras]) - centre
    height = float((away @ up).mean())
    flat = away - (away @ up)[:, None] * up
    radius = float(np.linalg.norm(flat, axis=1).mean())
    start = flat[0] / max(float(np.linalg.norm(flat[0])), 1e-12)
    side = np.cross(up, start)

    def camera(moment: float) -> Camera:
        angle = 2 * math.pi * turns * moment
        place = centre + height * up + radius * (math.cos(angle) * start + math.sin(angle) * side)
        return looking_at(first, place, centre, up)

    return camera


def dolly(camera: Camera, distance: float, *, held_depth: float | None = None) -> Path:
    """Move forward by `distance`, scene units (backward if negative).

    held_depth: z of a plane, scene units, that keeps its size in the image, by zooming out (a dolly zoom); None without
    a zoom. Raises ValueError if the camera would reach that plane.
    """
    if held_depth is not None and not held_depth > max(distance, 0.0):
        raise ValueError(f"held_depth: expected more than the way of {distance:g}, found {held_depth:g}")
    forward = camera.camera_to_world[:3, 2]

    def moved(moment: float) -> Camera:
        way = distance * moment
        zoom = 1.0 if held_depth is None else (held_depth - way) / held_depth
        placed = _placed(camera, camera.centre + way * forward, camera.camera_to_world[:3, :3])
        return replace(placed, fx=camera.fx * zoom, fy=camera.fy * zoom)

    return moved


def looking_at(camera: Camera, place: np.ndarray, target: np.ndarray, up: np.ndarray) -> Camera:
    """The camera at `place`, (3,), turned to `target` with `up` upwards in the image.

    Raises ValueError where the place is the target, or the view is along `up`.
    """
    forward = np.asarray(target, dtype=np.float64) - place
    right = np.cross(forward, up)
    if not (np.linalg.norm(forward) > 0 and np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward)):
        raise ValueError("looking_at: expected a target away from the camera, and not along up")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return _placed(camera, place, np.stack([right, np.cross(forward, right), forward], axis=1))


def mean_camera(cameras: Sequence[Camera]) -> Camera:
    """The first camera, moved to the mean position and turned to the mean direction and up of all."""
    first = _required(cameras)
    place = np.mean([camera.centre for camera in cameras], axis=0)
    forward = np.sum([camera.camera_to_world[:3, 2] for camera in cameras], axis=0)
    return looking_at(first, place, place + forward, mean_up(cameras))


def mean_up(cameras: Sequence[Camera]) -> np.ndarray:
    """(3,) unit vector: the mean of what is upwards in the images."""
    total = -np.sum([camera.camera_to_world[:3, 1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(total))
    if length < 1e-9:
        raise ValueError("cameras: expected a common up, found views that cancel each other")
    return np.asarray(total / length)


def looked_at(cameras: Sequence[Camera]) -> np.ndarray:
    """(3,) point nearest to all optical axes, in the sense of least squares. For parallel axes it is undetermined along
    them: then it is as near to the cameras as may be."""
    lhs, rhs = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        axis = camera.camera_to_world[:3, 2]
        across = np.eye(3) - np.outer(axis, axis)
        lhs, rhs = lhs + across, rhs + across @ camera.centre
    point, *_ = np.linalg.lstsq(lhs, rhs, rcond=1e-9)
    return np.asarray(point)


def resized_to(camera: Camera, width: int) -> Camera:
    """The same view `width` pixels wide, with an even number of rows and columns, which H.264 needs."""
    wide = max(2, width - width % 2)
    high = max(2, 2 * round(camera.height * wide / camera.width / 2))
    return camera.resized(wide, high)


def _placed(camera: Camera, place: np.ndarray, camera_to_world: np.ndarray) -> Camera:
    """The camera at `place`, (3,), with this rotation, (3, 3)."""
    pose = np.eye(4)
    pose[:3, :3] = camera_to_world.T
    pose[:3, 3] = -camera_to_world.T @ place
    return replace(camera, world_to_camera=pose)


def _moments(places: np.ndarray) -> np.ndarray:
    """Moments in proportion to the way along the places (P, 3); evenly spaced where all are one place."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if steps.sum() == 0:
        return np.linspace(0, 1, len(places))
    steps = np.maximum(steps, 1e-3 * steps.max())  # two cameras of one place are still passed one after the other
    moments = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    moments[-1] = 1.0
    return moments


def _required(cameras: Sequence[Camera]) -> Camera:
    if not cameras:
        raise ValueError("cameras: expected at least one, found none")
    return cameras[0]
