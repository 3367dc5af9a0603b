"""A small light field in closed form: three textured planes facing the cameras, seen exactly from every place.

A plane of parallax q, in pixels per unit, that the centre view shows at x is at x - q c in the view of a camera moved
by c (right, down). Textures are sums of waves of at least five pixels, and outlines are two pixels soft, so that views
may be sampled between pixels.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.images import write_png
from dofbench.optics.tone import encode

WIDTH, HEIGHT, STEPS, STEP = 160, 120, 4, 5.0  # STEP: units between views
# Pixels per step of the far wall, of a disc in the middle and of one in front. Positive is nearer than the plane on
# which the views are registered.
FAR, MIDDLE, NEAR = -0.5, 0.1, 0.6
_SOFT, _WAVES = 2.0, 14


@dataclass(frozen=True)
class Turn:
    """How positions in grid.json relate to the images: turned by `angle`, radians; rows run up or down."""

    angle: float = 0.03
    rows_up: bool = True


def camera_offsets(turn: Turn = Turn(), jitter: float = 0.08) -> dict[tuple[int, int], np.ndarray]:
    """(right, down) of every camera from the centre's, units, by (row, column) step; the centre view's is zero."""
    random = np.random.default_rng(3)
    offsets = {}
    for row in range(-STEPS, STEPS + 1):
        for column in range(-STEPS, STEPS + 1):
            off = random.uniform(-jitter, jitter, 2) if (row, column) != (0, 0) else np.zeros(2)
            offsets[row, column] = STEP * (np.array([column, -row if turn.rows_up else row], dtype=float) + off)
    return offsets


def seen(offset: np.ndarray, x: np.ndarray, y: np.ndarray, common: float = 0.0) -> np.ndarray:
    """Linear light (..., 3) that a camera moved by `offset` (right, down) sees at image coordinates x, y.

    common: parallax that all planes have besides their own, pixels per step.
    """
    light = np.zeros((*x.shape, 3))
    for index, (own, cover) in enumerate(_PLANES):
        per_unit = (own + common) / STEP
        at_x, at_y = x + per_unit * offset[0], y + per_unit * offset[1]
        share = cover(at_x, at_y)[..., None]
        light = (1 - share) * light + share * _texture(index, at_x, at_y)
    return light


def parallax(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pixels per step of what the centre view shows at image coordinates x, y."""
    found = np.full(x.shape, FAR)
    for plane, cover in _PLANES[1:]:
        found = np.where(cover(x, y) > 0.5, plane, found)
    return found


def pixels(width: int = WIDTH, height: int = HEIGHT, margin: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Image coordinates x, y, (H, W), of the pixel centres of the views, without a margin."""
    return np.meshgrid(np.arange(margin, width - margin) + 0.5, np.arange(margin, height - margin) + 0.5)


def write_light_field(folder: Path, turn: Turn = Turn(), *, positions: bool = True, common: float = 0.0) -> Path:
    """Write the views, encoded, 8 bit, and grid.json, with positions unless told; returns the folder. common: as in
    `seen`."""
    x, y = pixels()
    cos, sin = np.cos(turn.angle), np.sin(turn.angle)
    stated = {}
    for (row, column), offset in camera_offsets(turn, 0.08 if positions else 0.0).items():
        name = f"{row + STEPS:02d}_{column + STEPS:02d}"
        write_png(folder / "views" / f"{name}.png", encode(seen(offset, x, y, common)))
        right, down = offset
        # (first, second) such that the camera's (down, right) is a rotation of them; far from the origin.
        stated[name] = [900.0 + cos * down + sin * right, -3000.0 - sin * down + cos * right]
    grid = {"centre": f"{STEPS:02d}_{STEPS:02d}"} | ({"position_vu_mm": stated} if positions else {})
    (folder / "grid.json").write_text(json.dumps(grid))
    return folder


def averaged_over_disc(centre: np.ndarray, radius: float, focus: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Linear light at x, y by a lens with a disc of `radius` units around `centre` (right, down), focused on a plane of
    `focus` pixels per step: the mean of what 100 cameras evenly over the disc see, without the views' pixels."""
    count = np.arange(100) + 0.5
    away, angle = radius * np.sqrt(count / 100), np.pi * (1 + 5**0.5) * count
    total = np.zeros((*x.shape, 3))
    for u in np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1):
        total += seen(centre + u, x - focus / STEP * u[0], y - focus / STEP * u[1])
    return total / 100


def encoded(light: np.ndarray) -> np.ndarray:
    """As images hold it."""
    return encode(np.clip(light, 0, 1))


def _texture(index: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    random = np.random.default_rng(index)
    frequency, angle, phase = 2 * np.pi * random.uniform([0.02, 0.0, 0.0], [0.2, 0.5, 1.0], (_WAVES, 3)).T
    along = x[..., None] * (frequency * np.cos(angle)) + y[..., None] * (frequency * np.sin(angle))
    waves = np.cos((along + phase).astype(np.float32))  # four times as fast as in float64, to a millionth
    return np.clip(0.4 + waves @ random.uniform(0.02, 0.08, (_WAVES, 3)), 0.0, 1.0)


def _disc(x0: float, y0: float, radius: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda x, y: np.clip(0.5 + (radius - np.hypot(x - x0, y - y0)) / _SOFT, 0, 1)


_PLANES: tuple[tuple[float, Callable[[np.ndarray, np.ndarray], np.ndarray]], ...] = (
    (FAR, lambda x, y: np.ones(x.shape)),
    (MIDDLE, _disc(52.0, 50.0, 27.0)),
    (NEAR, _disc(112.0, 70.0, 29.0)),
)
