"""Planes before an exact thin lens: truth without noise of rendering, depth that is known, nothing to download.

Seen from the point u of a lens of unit radius, a point whose image through the lens' centre is p, with the signed
radius s, lands on p + s u. For a plane s is affine in p, so what a pixel sees of it is found by one division, and a
photograph is the mean over points that cover the lens evenly. Hidden parts are there, since every plane
is a picture of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from dofbench.images import encode
from dofbench.lens import GAMMA
from dofbench.validation.truth import Truth

WIDTH, HEIGHT = 400, 300
POINTS = 256
_TEXTURE = 1024  # pixels, side of a plane's picture; it repeats


@dataclass(frozen=True)
class Plane:
    """A textured plane, cut out by a stencil.

    texture: seed of its picture, whose finest detail is `detail` pixels. stencil: what of it is there. disparity:
    at the image's centre, and its slope by x and y per half width, so that 0 is the farthest thing and 1 the nearest.
    highlights: share of the picture that is `brightness` times as bright as white.
    """

    texture: int
    detail: float
    stencil: str
    disparity: float
    slope: tuple[float, float] = (0.0, 0.0)
    highlights: float = 0.0
    brightness: float = 30.0


SCENES: dict[str, tuple[Plane, ...]] = {  # far to near
    "two walls": (Plane(1, 2.0, "all", 0.1), Plane(2, 2.0, "discs", 0.9)),
    "thin bars": (Plane(3, 2.0, "all", 0.05), Plane(4, 4.0, "bars", 0.85)),
    "slanted floor": (Plane(5, 3.0, "all", 0.0), Plane(6, 2.0, "lower half", 0.45, (0.0, 0.5)),
                      Plane(7, 2.0, "discs", 1.0)),
    "highlights": (Plane(8, 3.0, "all", 0.0, highlights=0.002), Plane(9, 3.0, "discs", 0.6)),
    "flat walls": (Plane(10, 60.0, "all", 0.1), Plane(11, 60.0, "discs", 0.8), Plane(12, 60.0, "bars", 1.0)),
}


def planes(radius: float, focuses: tuple[float, ...], points: int = POINTS) -> Iterator[Truth]:
    """Photographs of every scene through a lens that blurs by `radius` pixels per unit of disparity."""
    for name, scene in SCENES.items():
        for focus in focuses:
            yield photograph(name, scene, radius, focus, points)


def photograph(name: str, scene: tuple[Plane, ...], radius: float, focus: float, points: int = POINTS) -> Truth:
    """One scene, far to near, through a lens of `radius` pixels per unit of disparity, focused at `focus`."""
    sharp, signed_radius = _view(scene, radius, focus, 0.0, 0.0)
    halves = [np.zeros_like(sharp), np.zeros_like(sharp)]
    index = np.arange(points) + 0.5
    for i, (rho, angle) in enumerate(zip(np.sqrt(index / points), math.pi * (1 + 5**0.5) * index, strict=True)):
        halves[i % 2] += _view(scene, radius, focus, rho * math.cos(angle), rho * math.sin(angle))[0]
    whole = (halves[0] + halves[1]) / points
    encoded, half = (encode(np.clip(image, 0, 1)).astype(np.float32) for image in (whole, halves[0] / (points / 2)))
    difference = float(np.mean((encoded - half) ** 2))
    return Truth(
        source="planes", name=name, aperture=float(np.abs(signed_radius).max()), focus=focus,
        # A highlight stays brighter than white in what the renderer gets.
        sharp=encode(sharp).astype(np.float32), signed_radius=signed_radius.astype(np.float32), photograph=encoded,
        gamma=GAMMA, border=math.ceil(radius) + 2,
        own_error_db=-10 * math.log10(difference) if difference > 0 else math.inf,
    )


def _view(
    scene: tuple[Plane, ...], radius: float, focus: float, ux: float, uy: float
) -> tuple[np.ndarray, np.ndarray]:
    """(linear image, signed radius) from one point of the lens."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    image, front = np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH))
    for plane in scene:
        # s(p) = a + bx px + by py in pixels; x = p + s(p) u, so s(p) = (a + b . x) / (1 + b . u).
        bx, by = (radius * slope / (WIDTH / 2) for slope in plane.slope)
        a = radius * (plane.disparity - focus) - bx * WIDTH / 2 - by * HEIGHT / 2
        s = (a + bx * x + by * y) / (1 + bx * ux + by * uy)
        px, py = x - s * ux, y - s * uy
        # Without slope s is one number, and the picture is only shifted.
        colour = _sampled(_picture(plane), px, py) if any(plane.slope) else _shifted(_picture(plane), -a * ux, -a * uy)
        there = np.clip(_stencil(plane.stencil, px, py) + 0.5, 0, 1)[..., None]
        image = there * colour + (1 - there) * image
        front = np.where(there[..., 0] > 0.5, s, front)
    return image, front


def _shifted(picture: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """What `_sampled` gives at (x + dx, y + dy) for the pixels (x, y) of the view, in a fraction of its time."""
    left, top = math.floor(dx), math.floor(dy)
    right_share, lower_share = np.float32(dx - left), np.float32(dy - top)
    rows, columns = np.arange(HEIGHT + 1) + top, np.arange(WIDTH + 1) + left
    part = picture[np.ix_(rows % _TEXTURE, columns % _TEXTURE)]
    part = part[:, :-1] * (1 - right_share) + part[:, 1:] * right_share
    return part[:-1] * (1 - lower_share) + part[1:] * lower_share


def _sampled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The periodic picture at pixel positions, bilinear. OpenCV would round positions to 1/32 pixel."""
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right_share, lower_share = (x - left)[..., None].astype(np.float32), (y - top)[..., None].astype(np.float32)
    columns, rows = (left % _TEXTURE, (left + 1) % _TEXTURE), (top % _TEXTURE, (top + 1) % _TEXTURE)
    upper, lower = (
        picture[row, columns[0]] * (1 - right_share) + picture[row, columns[1]] * right_share for row in rows
    )
    return upper * (1 - lower_share) + lower * lower_share


@cache
def _picture(plane: Plane) -> np.ndarray:
    """(1024, 1024, 3) float32 linear light, periodic: noise, no finer than the plane's detail, and highlights."""
    generator = np.random.default_rng(plane.texture)
    fy, fx = np.meshgrid(np.fft.fftfreq(_TEXTURE), np.fft.fftfreq(_TEXTURE), indexing="ij")
    frequency = np.hypot(fy, fx)
    # As much contrast in every octave up to the finest.
    spectrum = np.where(frequency > 0, 1 / np.maximum(frequency, 1 / _TEXTURE), 0) * np.exp(
        -((frequency * 2 * plane.detail) ** 2))
    noise = generator.normal(size=(_TEXTURE, _TEXTURE, 3))
    waves = np.fft.ifft2(np.fft.fft2(noise, axes=(0, 1)) * spectrum[..., None], axes=(0, 1)).real
    picture = np.clip(0.45 + 0.2 * waves / waves.std(), 0.0, 1.0) ** GAMMA
    if plane.highlights > 0:
        lit = generator.random((_TEXTURE, _TEXTURE)) < plane.highlights / 4
        lit = lit | np.roll(lit, 1, 0) | np.roll(lit, 1, 1) | np.roll(lit, (1, 1), (0, 1))
        picture[lit] = plane.brightness
    return picture.astype(np.float32)


def _stencil(kind: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Signed distance to the stencil's edge, pixels, positive inside."""
    if kind == "all":
        return np.full(x.shape, 1.0)
    if kind == "lower half":
        return y - 0.45 * HEIGHT
    if kind == "discs":
        centres = ((0.28, 0.35, 42), (0.72, 0.55, 60), (0.45, 0.85, 30))
        return np.max([r - np.hypot(x - cx * WIDTH, y - cy * HEIGHT) for cx, cy, r in centres], axis=0)
    if kind == "bars":
        return np.max([w - np.abs((x - c * WIDTH) * math.cos(t) + (y - 0.5 * HEIGHT) * math.sin(t))
                       for c, w, t in ((0.2, 1.0, 0.1), (0.4, 2.0, -0.2), (0.6, 4.0, 0.3), (0.8, 1.5, -0.4))], axis=0)
    raise ValueError(f"stencil: expected all, lower half, discs or bars, found {kind!r}")
