"""An unbounded outdoor scene: grass at the camera's feet, trees, hills, and a sky at infinity."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import blade, box, ground, leaf, lid, merged, rod
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import cloudy

TITLE = "meadow with trees, hills and sky: unbounded, the background at infinity"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.05), (0.0, 4.0, 0.80), (0.32, 0.05, 0.18), aim=0.06, arc=360)
_CENTRE = np.array([0.0, 4.0])


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 17])
    sun = (-0.55, -0.35, 0.75)
    far = 400.0 * np.array(sun)
    # A sun of five degrees, ten times as wide as the real one and dimmer accordingly: its shadows are softer.
    lamps = (Lamp((far[0], far[1], far[2]), (0.0, 4.0, 0.0), 36.0, 330.0),)
    return Stage((*_land(rng), *_grass(rng), *_sundial(rng), *_trees(rng)), lamps, cloudy(rng, sun))


def _hill(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Flat around the middle, and hills behind 30 units all round."""
    away = np.hypot(x - _CENTRE[0], y - _CENTRE[1])
    rise = np.clip((away - 25) / 150, 0, 1) ** 1.5
    return rise * (12 + 9 * np.sin(0.030 * x + 1.0) * np.cos(0.024 * y) + 5 * np.sin(0.07 * x + 0.05 * y))


def _land(rng: np.random.Generator) -> Iterable[Prop]:
    turf = textures.mix((0.22, 0.34, 0.12), (0.56, 0.62, 0.28), 0.5 + 0.28 * textures.fractal(rng, 1024, 1024, 1.0))
    edge = np.linspace(-1, 1, 141)
    grid = 220 * np.sign(edge) * edge**2
    yield Prop(ground(grid, grid + 4, _hill, 9.0), textures.finish(turf))
    stones = [
        box(x, y, (w, 0.7 * w, 0.06), turn, -0.02)
        for x, y, w, turn in zip(
            rng.uniform(-0.3, 0.3, 12),
            np.linspace(0.8, 12, 12),
            rng.uniform(0.35, 0.5, 12),
            rng.uniform(0, 90, 12),
            strict=True,
        )
    ]
    yield Prop(merged(stones), textures.marble(rng, 256, 256))


def _grass(rng: np.random.Generator) -> Iterable[Prop]:
    """Blades in a ring around the middle, with flowers among them; none on the inner lawn."""
    blades, petals, cores, stems = [], [], [], []
    for _ in range(2600):
        angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(1.5, 3.1)
        x, y = _CENTRE + away * np.array([np.cos(angle), np.sin(angle)])
        lean = rng.uniform(-0.16, 0.16, 2)
        height, width = rng.uniform(0.14, 0.46), rng.uniform(0.010, 0.020)
        blades.append(blade((x, y, 0), (lean[0], lean[1]), height, width, rng.uniform(0, np.pi), 6))
    for _ in range(90):
        angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(1.3, 2.9)
        x, y = _CENTRE + away * np.array([np.cos(angle), np.sin(angle)])
        head = np.array([x, y, rng.uniform(0.30, 0.62)])
        stems.append(rod((x, y, 0), head, 0.006, 6))
        for turn in np.linspace(0, 2 * np.pi, 7)[:-1] + rng.uniform(0, 1):
            way = np.array([np.cos(turn), np.sin(turn), 0.25])
            petals.append(leaf(head, 0.07 * way, (-way[0], -way[1], 3.0), 0.045, 0.1, 4))
        cores.append(box(head[0], head[1], (0.026, 0.026, 0.016), 0, head[2]))
    yield Prop(merged(blades), textures.leaf(rng))
    yield Prop(merged(stems), (0.30, 0.46, 0.20))
    yield Prop(
        merged(petals),
        textures.mix((0.95, 0.93, 0.90), (0.86, 0.40, 0.60), 0.5 + 0.4 * textures.fractal(rng, 64, 64, 1.4)),
    )
    yield Prop(merged(cores), (0.95, 0.75, 0.18))


def _sundial(rng: np.random.Generator) -> Iterable[Prop]:
    """In the middle: a stone pillar with a ball, and crates around it."""
    yield Prop(Tube((0, 4, 0), (0, 4, 0.75), 0.20, 40), textures.marble(rng))
    yield Prop(lid(0, 4, 0.75, 0.20), (0.7, 0.7, 0.66))
    yield Prop(Sphere((0, 4, 0.97), 0.22, 15), textures.quilt(rng, 512, 1024, 7))
    for x, y, turn in ((-0.62, 3.7, 20), (0.58, 4.3, -30), (0.45, 3.45, 10), (-0.4, 4.7, 50)):
        yield Prop(
            box(x, y, (0.34, 0.34, 0.32), turn),
            textures.letter(rng, str(rng.choice(list("ABDEFKR"))), textures.some(rng)),
        )


def _trees(rng: np.random.Generator) -> Iterable[Prop]:
    trunks, crowns = [], []
    for _ in range(46):
        angle, away = rng.uniform(0, 2 * np.pi), float(np.exp(rng.uniform(np.log(9), np.log(90))))
        x, y = _CENTRE + away * np.array([np.cos(angle), np.sin(angle)])
        base = float(_hill(np.array(x), np.array(y)))
        tall = rng.uniform(2.6, 5.2)
        trunks.append(rod((x, y, base - 0.3), (x, y, base + 0.7 * tall), 0.035 * tall, 10))
        for _ in range(170):
            way = rng.normal(size=3)
            place = np.array([x, y, base + 0.72 * tall]) + 0.34 * tall * way / np.linalg.norm(way) * rng.uniform(0.4, 1)
            along = rng.normal(size=3)
            along *= rng.uniform(0.10, 0.17) * tall / np.linalg.norm(along)
            crowns.append(leaf(place, along, np.cross(along, rng.normal(size=3)), 0.09 * tall, 0.2, 3))
    yield Prop(merged(trunks), (0.36, 0.26, 0.18))
    yield Prop(merged(crowns), textures.leaf(rng))
