"""Varnish and metal under small, strong lamps: opaque, and with highlights that move with the lens point."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, lid, quad
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, directions

TITLE = "varnished and metal things under small strong lamps: gloss"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.25), (0.0, 3.1, 0.35), (0.28, 0.05, 0.18), aim=0.05, arc=50)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 16])
    lamps = (
        Lamp((-2.0, 0.4, 3.6), (0.0, 3.2, 0.2), 0.30, 300.0),
        Lamp((1.8, 1.6, 3.2), (0.2, 3.6, 0.2), 0.24, 360.0),
        Lamp((0.4, 6.4, 4.4), (0.0, 7.0, 0.0), 0.7, 90.0),
    )
    return Stage((*_table(rng), *_balls(rng)), lamps, _softboxes(rng))


def _softboxes(rng: np.random.Generator) -> np.ndarray:
    """A grey studio with bright panels, which are reflected in metal."""
    way = directions(256)
    studio = 0.10 + 0.18 * np.clip(way[..., 2], 0, 1)
    for centre, size, power in (
        ((-0.8, -0.4, 0.6), 0.30, 1.8),
        ((0.9, 0.1, 0.5), 0.22, 1.5),
        ((0.1, 0.5, 0.9), 0.35, 1.2),
    ):
        facing = way @ (np.array(centre) / np.linalg.norm(centre))
        studio = studio + power / (1 + np.exp((np.arccos(np.clip(facing, -1, 1)) - size) / 0.02))
    stripes = 0.04 * np.sin(24 * np.arctan2(way[..., 1], way[..., 0]))
    return np.clip(studio + stripes, 0.02, None)[..., None].repeat(3, axis=2).astype(np.float32)


def _table(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-7, -2, 0), (14, 0, 0), (0, 11, 0), (2, 2)), textures.wood(rng, 1024, 1344, 13))
    yield Prop(quad((-9, 8.6, 0), (18, 0, 0), (0, 0, 7)), textures.plaid(rng, 1024, 1024))
    yield Prop(quad((-1.1, 1.7, 0.004), (2.2, 0, 0), (0, 2.4, 0)), textures.newspaper(rng))


def _balls(rng: np.random.Generator) -> Iterable[Prop]:
    places = (
        (-0.62, 2.15, 0.15),
        (0.05, 2.05, 0.12),
        (0.58, 2.45, 0.17),
        (-0.25, 2.75, 0.20),
        (0.30, 3.15, 0.22),
        (-0.85, 3.25, 0.26),
        (0.95, 3.6, 0.28),
        (-0.15, 3.95, 0.24),
    )
    for index, (x, y, radius) in enumerate(places):
        if index % 3 == 1:
            tint = ((0.95, 0.93, 0.90), (0.98, 0.80, 0.45), (0.95, 0.62, 0.50))[index // 3]
            yield Prop(Sphere((x, y, radius), radius), tint, "metal", 0.08)
        else:
            skin = textures.cells(rng, 256, 512, 40) if index % 3 == 0 else BRIGHT[index % 8]
            yield Prop(Sphere((x, y, radius), radius, 30.0 * index), skin, "glossy", 0.05)
    yield Prop(Tube((1.55, 4.6, 0), (1.55, 4.6, 0.9), 0.28, 30), textures.label(rng, BRIGHT[2]), "glossy", 0.08)
    yield Prop(lid(1.55, 4.6, 0.9, 0.28), (0.9, 0.9, 0.92), "metal", 0.15)
    yield Prop(box(-1.9, 4.9, (0.8, 0.5, 0.7), 24), textures.carton(rng), "glossy", 0.10)
    yield Prop(Sphere((0.2, 5.6, 0.55), 0.55, 80), textures.marble(rng, 512, 1024), "glossy", 0.05)
    yield Prop(box(-1.0, 6.6, (0.9, 0.6, 1.2), -18), textures.quilt(rng, 512, 384, 5), "glossy", 0.12)
    yield Prop(Sphere((2.3, 6.9, 0.6), 0.6), (0.96, 0.94, 0.90), "metal", 0.10)
