"""A scene as plain data, independent of the renderer, and its camera paths.

World axes: x to the right, y away from the cameras, z up. Lengths are scene units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.scenes.procedural.ink import Colour

Finish = Literal["matt", "glossy", "metal", "lamp"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles. vertices: (V, 3). faces: (T, 3) indices. uv: (V, 2), u to the repeated texture's right, v up."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball. turn: degrees about the vertical axis, which moves its texture."""

    centre: Vector
    radius: float
    turn: float = 0.0


@dataclass(frozen=True, eq=False)
class Tube:
    """An open cylinder from `start` to `end`."""

    start: Vector
    end: Vector
    radius: float
    turn: float = 0.0


@dataclass(frozen=True, eq=False)
class Prop:
    """A shape and its surface. texture: encoded (H, W, 3), or one colour.

    finish: "matt" (Lambertian); "glossy" (varnished), "metal" (reflects in the texture's colour), both with
    `roughness`; "lamp" emits `radiance` (linear light) times the texture, without illuminating other props.
    """

    shape: Mesh | Sphere | Tube
    texture: np.ndarray | Colour
    finish: Finish = "matt"
    roughness: float = 0.10
    radiance: float = 1.0


@dataclass(frozen=True, eq=False)
class Lamp:
    """A square area light at `centre` that faces `target`. radiance: linear light."""

    centre: Vector
    target: Vector
    side: float
    radiance: float


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Camera positions. eye, target: middle of the path, and the point that the cameras look at. extent: half-extents
    (right, forward, up) of the forward-facing path. aim: jitter of the target. roll: degrees. focal: pixels per pixel
    of width. arc: degrees that an orbit spans."""

    eye: Vector
    target: Vector
    extent: Vector
    aim: float
    roll: float = 1.5
    focal: float = 0.875
    arc: float = 60.0


@dataclass(frozen=True, eq=False)
class Stage:
    """Content of a scene. sky: linear radiance at infinity, one number, or a map (H, 2 H, 3) whose first row is the
    zenith and whose columns go round from x through y."""

    props: tuple[Prop, ...]
    lamps: tuple[Lamp, ...]
    sky: float | np.ndarray


PathKind = Literal["forward", "orbit"]
_SHAKE = 0.05  # of the forward path's extent


def cameras(points: Viewpoints, kind: PathKind, count: int, width: int, height: int, seed: int) -> list[Camera]:
    """`count` pinhole cameras on a scene's path; focal length points.focal * width, principal point in the middle."""
    rng = np.random.default_rng([seed, 1])
    eyes = _spiral(points, count, rng) if kind == "forward" else _arc(points, count, rng)
    targets = np.array(points.target) + rng.uniform(-points.aim, points.aim, (count, 3))
    rolls = np.radians(rng.uniform(-points.roll, points.roll, count))
    focal = points.focal * width
    return [
        Camera(width, height, focal, focal, width / 2, height / 2, _look(eye, target, roll))
        for eye, target, roll in zip(eyes, targets, rolls, strict=True)
    ]


def _spiral(points: Viewpoints, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) positions on a sunflower spiral, of which the first n, or every n-th, cover the same ellipse, so that
    no test view lies far outside the training views."""
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    angle = index * np.pi * (3 - np.sqrt(5))
    across = np.stack([radius * np.cos(angle), rng.uniform(-1, 1, count), radius * np.sin(angle)], axis=1)
    return np.array(points.eye) + np.array(points.extent) * (across + rng.uniform(-_SHAKE, _SHAKE, (count, 3)))


def _arc(points: Viewpoints, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) positions evenly spaced around the vertical axis through the target; heights alternate."""
    eye, target = np.array(points.eye), np.array(points.target)
    angle = np.radians(points.arc) * ((np.arange(count) + 0.5) / count - 0.5)
    start = eye - target
    x = start[0] * np.cos(angle) - start[1] * np.sin(angle)
    y = start[0] * np.sin(angle) + start[1] * np.cos(angle)
    z = start[2] + points.extent[2] * rng.uniform(-1, 1, count)
    return target + np.stack([x, y, z], axis=1)


def _look(eye: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    return world_to_camera(eye, (target - eye) / np.linalg.norm(target - eye), roll)


def world_to_camera(eye: np.ndarray, forward: np.ndarray, roll: float) -> np.ndarray:
    """(4, 4) OpenCV axes, of a camera at `eye` that looks along `forward`, a unit vector.

    The world's z axis points up in the picture, apart from a roll of `roll` radians.
    """
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    pose = np.eye(4)
    pose[:3, :3] = [right, down, forward]
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose
