"""Identical tiles, columns and boxes in rows: every feature has many equal matches."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, lid, merged, quad
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "hall of identical tiles, columns and boxes: repeated texture"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.15), (0.0, 3.4, 0.75), (0.28, 0.05, 0.18), aim=0.06, arc=36)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 15])
    lamps = (Lamp((-1.8, 0.6, 4.4), (0.0, 3.0, 0.2), 1.6, 20.0), Lamp((1.8, 5.0, 4.4), (0.0, 7.2, 0.2), 1.6, 26.0))
    return Stage((*_hall(rng), *_rows(rng)), lamps, 0.35)


def _hall(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-6, -2, 0), (12, 0, 0), (0, 12, 0), (16, 16)), _checker())
    yield Prop(quad((-6, 9.6, 0), (12, 0, 0), (0, 0, 6), (20, 10)), _tile(rng))


def _checker(size: int = 128) -> np.ndarray:
    """Two by two squares, with a joint around each."""
    image = textures.flat(size, size, (0.86, 0.82, 0.74))
    half = size // 2
    image[:half, :half] = image[half:, half:] = (0.20, 0.24, 0.30)
    image[[0, half]] = image[:, [0, half]] = (0.45, 0.43, 0.40)
    return textures.finish(image)


def _tile(rng: np.random.Generator, size: int = 192) -> np.ndarray:
    """A glazed tile with a star."""
    rows, columns = np.mgrid[0:size, 0:size] / size - 0.5
    radius, angle = np.hypot(rows, columns), np.arctan2(rows, columns)
    star = radius < 0.20 + 0.16 * np.cos(8 * angle)
    image = textures.flat(size, size, (0.84, 0.86, 0.84)) + 0.02 * textures.fractal(rng, size, size, 1.2)[..., None]
    image[star] = (0.16, 0.38, 0.60)
    image[radius < 0.10] = BRIGHT[1]
    image[np.maximum(np.abs(rows), np.abs(columns)) > 0.475] = (0.50, 0.46, 0.42)
    return textures.finish(image)


def _rows(rng: np.random.Generator) -> Iterable[Prop]:
    """Two rows of wrapped columns, a rack of identical boxes, a row of identical balls."""
    wrap = textures.label(rng, BRIGHT[0])
    for y in np.arange(1.9, 9.0, 1.4):
        for x in (-1.35, 1.35):
            yield Prop(Tube((x, y, 0), (x, y, 3.2), 0.17, 90), np.tile(wrap, (6, 1, 1)))
    face = textures.quilt(rng, 256, 256, 3)
    boxes = [
        box(x, y, (0.26, 0.26, 0.26), 0, z)
        for y in (3.2, 4.4, 5.6)
        for x in (-0.68, -0.34, 0.0, 0.34, 0.68)
        for z in (0.0, 0.27)
        if z == 0 or abs(x) > 0.2
    ]
    yield Prop(merged(boxes), face)
    skin = textures.marble(rng)
    for x in (-0.75, -0.45, -0.15, 0.15, 0.45, 0.75):
        yield Prop(Sphere((x, 2.35, 0.10), 0.10, 30), skin, "glossy")
    yield Prop(Tube((0.0, 7.4, 0), (0.0, 7.4, 1.3), 0.32, 90), np.tile(wrap, (2, 2, 1)))
    yield Prop(lid(0.0, 7.4, 1.3, 0.32), (0.7, 0.7, 0.66))
