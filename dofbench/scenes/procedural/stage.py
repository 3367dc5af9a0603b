"""The content of a scene as plain data, independent of the renderer.

World axes: x to the right, y away from the cameras, z up. Lengths are scene units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dofbench.scenes.procedural.ink import Colour

Finish = Literal["matt", "glossy", "metal", "lamp"]
Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles. vertices: (V, 3). faces: (T, 3) indices. uv: (V, 2), u to the texture's right, v up; the texture
    repeats."""

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

    finish: "matt" is Lambertian; "glossy" is varnished, "metal" reflects in the texture's colour, both with
    `roughness`; "lamp" emits `radiance` (linear light) times the texture, but doesn't illuminate other props.
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
    """Where the cameras are. focal: pixels of focal length per pixel of width.

    eye, target: middle of the path, and the point that the cameras look at. extent: half-extents (right, forward, up)
    of the forward-facing path. aim: jitter of the target. roll: degrees. arc: degrees that an orbit spans.
    """

    eye: Vector
    target: Vector
    extent: Vector
    aim: float
    roll: float = 1.5
    focal: float = 0.875
    arc: float = 60.0


@dataclass(frozen=True, eq=False)
class Stage:
    """Everything the renderer needs.

    sky: linear radiance from all around at infinity, one number, or a map (H, 2 H, 3) whose first row is the zenith
    and whose columns go round from x through y.
    """

    props: tuple[Prop, ...]
    lamps: tuple[Lamp, ...]
    sky: float | np.ndarray
