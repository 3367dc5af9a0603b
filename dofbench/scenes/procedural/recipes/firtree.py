"""A fir tree with small lamps in a dark room: highlights in front of, inside and behind dark needles."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import Colour
from dofbench.scenes.procedural.shapes import box, leaf, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, night

TITLE = "fir tree with small bright lamps in a dark room: highlights"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.15), (0.0, 3.3, 0.86), (0.28, 0.05, 0.18), aim=0.05, arc=38)
_WARM: Colour = (1.0, 0.78, 0.46)
_COLOURS: tuple[Colour, ...] = (
    _WARM,
    _WARM,
    (1.0, 0.34, 0.24),
    (0.40, 0.62, 1.0),
    (0.46, 1.0, 0.50),
    (1.0, 0.62, 0.90),
)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 23])
    lamps = (Lamp((-2.2, 0.6, 3.8), (0.0, 3.2, 0.6), 0.8, 34.0), Lamp((2.4, 4.6, 4.2), (0.4, 7.0, 0.8), 0.9, 46.0))
    return Stage((*_room(rng), *_tree(rng), *_table(rng), *_window(rng)), lamps, night(rng))


def _room(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-6, -1.5, 0), (12, 0, 0), (0, 10.5, 0), (2, 2)), textures.wood(rng, 1024, 1344, 12), "glossy", 0.2)
    paper = textures.mix((0.30, 0.24, 0.30), (0.62, 0.52, 0.50), 0.5 + 0.22 * textures.fractal(rng, 768, 1024, 1.2))
    for x, y in rng.uniform(0, 1, (240, 2)) * (1024, 768):
        paper[int(y) : int(y) + 14, int(x) : int(x) + 8] = (0.78, 0.66, 0.42)
    yield Prop(quad((-6, 8.6, 0), (12, 0, 0), (0, 0, 5)), textures.finish(paper))
    yield Prop(quad((-3.3, 8.55, 1.0), (1.7, 0, 0), (0, 0, 1.6)), textures.poster(rng))


def _lit(rng: np.random.Generator, place: np.ndarray, radius: float) -> Prop:
    """A small lamp; how bright it is differs by a factor of twenty."""
    power = float(np.exp(rng.uniform(np.log(2.5), np.log(50))))
    colour = _COLOURS[int(rng.integers(len(_COLOURS)))]
    return Prop(Sphere((float(place[0]), float(place[1]), float(place[2])), radius), colour, "lamp", radiance=power)


def _tree(rng: np.random.Generator) -> Iterable[Prop]:
    """Whorls of drooping branches with needles; lamps along a spiral, and glossy balls."""
    x, y, tall = -0.25, 3.3, 1.95
    yield Prop(Tube((x, y, 0), (x, y, tall), 0.035), (0.28, 0.19, 0.12))
    twigs: list[Mesh] = []
    needles: list[Mesh] = []
    for z in np.linspace(0.28, tall - 0.1, 15):
        reach = 0.78 * (1 - z / (tall + 0.12))
        for angle in rng.uniform(0, 2 * np.pi) + np.arange(9) * 2 * np.pi / 9 + rng.uniform(-0.15, 0.15, 9):
            way = np.array([np.cos(angle), np.sin(angle), -0.22])
            root, tip = np.array([x, y, z]), np.array([x, y, z]) + reach * rng.uniform(0.8, 1.1) * way
            twigs.append(rod(root, tip, 0.007, 5))
            for share in rng.uniform(0.15, 1.0, 26):
                along = 0.09 * (way + 0.9 * rng.normal(size=3) * (1, 1, 0.6))
                needles.append(leaf(root + share * (tip - root), along, rng.normal(size=3), 0.012, 0.05, 2))
    yield Prop(merged(twigs), (0.26, 0.19, 0.12))
    yield Prop(merged(needles), textures.leaf(rng))
    for turn in np.linspace(0, 9 * 2 * np.pi, 92):
        z = 0.22 + (tall - 0.25) * turn / (9 * 2 * np.pi)
        away = 0.80 * (1 - z / (tall + 0.12)) + rng.uniform(-0.05, 0.05)
        yield _lit(rng, np.array([x + away * np.cos(turn), y + away * np.sin(turn), z]), 0.013)
    for _ in range(12):
        z, angle = rng.uniform(0.35, 1.5), rng.uniform(np.pi, 2 * np.pi)
        away = 0.74 * (1 - z / (tall + 0.12))
        centre = (float(x + away * np.cos(angle)), float(y + away * np.sin(angle)), float(z - 0.06))
        yield Prop(Sphere(centre, 0.05), BRIGHT[int(rng.integers(3))], "glossy", 0.06)
    yield _lit(rng, np.array([x, y, tall + 0.03]), 0.03)


def _table(rng: np.random.Generator) -> Iterable[Prop]:
    """Candles close to the camera, and parcels under the tree."""
    for cx, cy, high in ((-0.62, 1.75, 0.42), (0.46, 1.85, 0.36), (0.72, 2.15, 0.50)):
        yield Prop(turned(cx, cy, [(0.05, 0), (0.05, high), (0.0, high)], 0.0, 24), (0.90, 0.86, 0.78))
        flame = Sphere((cx, cy, high + 0.035), 0.014)
        yield Prop(flame, (1.0, 0.66, 0.30), "lamp", radiance=float(rng.uniform(14, 28)))
    for bx, by, size, turn, look in (
        (0.35, 2.75, (0.36, 0.30, 0.26), 24, textures.quilt(rng, 256, 256, 4)),
        (-0.85, 2.6, (0.40, 0.32, 0.20), -18, textures.plaid(rng, 384, 384)),
        (0.95, 3.6, (0.45, 0.36, 0.42), -30, textures.carton(rng)),
        (-1.5, 4.2, (0.60, 0.44, 0.60), 16, textures.cells(rng, 384, 384, 60)),
        (1.6, 5.4, (0.70, 0.60, 0.90), 20, textures.newspaper(rng, 512, 512)),
    ):
        yield Prop(box(bx, by, size, turn), look, "glossy", 0.16)


def _window(rng: np.random.Generator) -> Iterable[Prop]:
    """A garland over the wall behind, and lamps in a cabinet."""
    places = [np.array([u, 8.35, 2.5 - 0.5 * (1 - ((u % 1.6) / 0.8 - 1) ** 2)]) for u in np.linspace(-4.2, 4.2, 37)]
    yield Prop(merged(rod(a, b, 0.008, 5) for a, b in itertools.pairwise(places)), (0.10, 0.12, 0.10))
    for place in places:
        yield _lit(rng, place, 0.030)
    yield Prop(box(2.0, 7.6, (1.5, 0.7, 2.0)), (0.30, 0.20, 0.13))
    for z in (0.5, 1.0, 1.5):
        yield Prop(box(2.0, 7.21, (1.2, 0.04, 0.34), 0, z), (0.95, 0.80, 0.55), "lamp", radiance=1.2)
        for u in (1.6, 2.0, 2.4):
            yield Prop(Tube((u, 7.1, z), (u, 7.1, z + 0.22), 0.07), BRIGHT[int(rng.integers(8))])
