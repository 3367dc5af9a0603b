"""A village street that runs to far hills: walls, poles and trees from two to two hundred units, and open sky."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, ground, leaf, lid, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, cloudy

TITLE = "village street with far hills and sky: unbounded, the background at infinity"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.20), (0.0, 4.0, 0.92), (0.32, 0.05, 0.20), aim=0.06, arc=30)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 25])
    sun = (0.60, -0.45, 0.66)
    far = 400.0 * np.array(sun)
    # As the meadow's: a sun ten times as wide as the real one and dimmer accordingly.
    lamps = (Lamp((far[0], far[1], far[2]), (0.0, 6.0, 0.0), 36.0, 330.0),)
    return Stage((*_land(rng), *_houses(rng), *_lane(rng), *_near(rng), *_trees(rng)), lamps, cloudy(rng, sun))


def _height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Flat along the street, hills behind 60 units."""
    away = np.hypot(x, y)
    rise = np.clip((away - 55) / 180, 0, 1) ** 1.3
    return rise * (24 + 16 * np.sin(0.021 * x + 2.0) + 9 * np.cos(0.034 * x - 0.02 * y))


def _land(rng: np.random.Generator) -> Iterable[Prop]:
    turf = textures.mix((0.26, 0.32, 0.14), (0.62, 0.58, 0.32), 0.5 + 0.28 * textures.fractal(rng, 1024, 1024, 1.0))
    edge = np.linspace(-1, 1, 121)
    grid = 260 * np.sign(edge) * edge**2
    yield Prop(ground(grid, grid + 4, _height, 11.0), textures.finish(turf))
    cobbles = textures.flat(768, 768, (0.36, 0.34, 0.32))
    for row in range(32):
        for column in range(24):
            top, left = 24 * row, 32 * column + 16 * (row % 2)
            shade = rng.uniform(0.42, 0.76)
            cobbles[top + 2 : top + 23, left + 2 : left + 31] = shade * np.array([1.0, 0.97, 0.92])
    cobbles += 0.03 * textures.fractal(rng, 768, 768, 1.1)[..., None]
    yield Prop(quad((-1.7, -2, 0.01), (3.4, 0, 0), (0, 62, 0), (2, 36)), textures.finish(cobbles))


def _houses(rng: np.random.Generator) -> Iterable[Prop]:
    """Two rows of house fronts with windows, doors and gabled roofs."""
    for side in (-1, 1):
        y = 4.6 + 0.9 * (side > 0)
        while y < 52:
            long, tall = rng.uniform(3.4, 5.6), rng.uniform(2.6, 4.4)
            x = side * rng.uniform(2.5, 3.0)
            wall = textures.bricks(rng, 512, 768, int(rng.integers(13, 20))) if rng.random() < 0.5 else _render(rng)
            yield Prop(box(x + side * 2.0, y + long / 2, (4.0, long, tall)), wall)
            yield Prop(_roof(x, side, y, long, tall), _tiles(rng))
            panes, frames = [], []
            for v in np.arange(y + 0.6, y + long - 0.8, 1.15):
                for z in np.arange(0.8, tall - 0.9, 1.35):
                    panes.append(box(x, v + 0.3, (0.06, 0.56, 0.80), 0, z))
                    frames.append(box(x, v + 0.3, (0.09, 0.66, 0.06), 0, z - 0.06))
            yield Prop(merged(panes), (0.20, 0.25, 0.30))
            yield Prop(merged(frames), (0.90, 0.88, 0.84))
            yield Prop(box(x, y + long - 0.55, (0.08, 0.62, 1.7)), BRIGHT[int(rng.integers(8))])
            y += long + rng.uniform(0.0, 1.2)


def _render(rng: np.random.Generator) -> np.ndarray:
    """Weathered lime wash."""
    tint = np.array(BRIGHT[int(rng.choice([1, 4, 7]))]) * 0.5 + 0.45
    stain = textures.fractal(rng, 384, 512, 1.5)
    image = np.clip(tint, 0, 1) * (0.86 + 0.09 * stain)[..., None]
    return textures.finish(image + 0.03 * textures.fractal(rng, 384, 512, 0.9)[..., None])


def _roof(x: float, side: int, y: float, long: float, tall: float) -> Mesh:
    """The slope of a roof that faces the street."""
    low, over = np.array([x - 0.25 * side, y - 0.1, tall - 0.05]), np.array([2.2 * side, 0.0, 1.5])
    along = np.array([0.0, long + 0.2, 0.0])
    return quad(low + along, -along, over, (3, 1)) if side > 0 else quad(low, along, over, (3, 1))


def _tiles(rng: np.random.Generator) -> np.ndarray:
    rows, columns = np.mgrid[0:320, 0:320]
    shade = 0.5 + rng.uniform(-0.4, 0.4, (21, 41))[rows // 16, (columns + 8 * (rows // 16 % 2)) // 8 % 41]
    image = textures.mix((0.42, 0.20, 0.14), (0.76, 0.42, 0.30), shade)
    image[rows % 16 < 2] *= 0.55
    return textures.finish(image)


def _lane(rng: np.random.Generator) -> Iterable[Prop]:
    """Lamp posts with a wire from one to the next, barrels and crates along the kerb."""
    posts = [np.array([1.55, y, 0.0]) for y in (4.2, 8.8, 13.5, 19, 26, 35, 46)]
    iron = []
    for foot in posts:
        iron += [rod(foot, foot + (0, 0, 2.6), 0.035), rod(foot + (0, 0, 2.6), foot + (-0.5, 0, 2.75), 0.02)]
    for a, b in itertools.pairwise(posts):
        sag = [a + t * (b - a) + (0, 0, 2.6 - 0.9 * t * (1 - t)) for t in np.linspace(0, 1, 9)]
        iron += [rod(p, q, 0.008, 5) for p, q in itertools.pairwise(sag)]
    yield Prop(merged(iron), (0.14, 0.17, 0.16))
    for foot in posts:
        yield Prop(Sphere((float(foot[0]) - 0.5, float(foot[1]), 2.62), 0.11), (0.92, 0.90, 0.84), "glossy", 0.1)
    barrel = [(0.20, 0.0), (0.27, 0.22), (0.27, 0.42), (0.20, 0.64), (0.0, 0.64)]
    for x, y in ((-1.45, 5.3), (-1.25, 6.0), (1.35, 7.3), (-1.4, 11.2), (1.4, 16.0)):
        yield Prop(turned(x, y, barrel), np.rot90(textures.wood(rng, 384, 512, 12)).copy())
    for x, y, turn in ((1.2, 5.0, 24), (-1.15, 8.4, -12), (0.95, 10.4, 30)):
        yield Prop(
            box(x, y, (0.55, 0.45, 0.5), turn), textures.letter(rng, str(rng.choice(list("BFKRX"))), textures.some(rng))
        )


def _near(rng: np.random.Generator) -> Iterable[Prop]:
    """A hand cart with boxes, a milk can and a sign, two to four units away."""
    yield Prop(box(0.05, 3.3, (0.9, 0.6, 0.08), 14, 0.42), textures.wood(rng, 384, 512, 5))
    yield Prop(box(-0.12, 3.25, (0.34, 0.30, 0.34), 20, 0.50), textures.carton(rng))
    yield Prop(Sphere((0.30, 3.36, 0.62), 0.13, 40), textures.quilt(rng, 256, 512, 5))
    wheel = []
    for side in (-0.36, 0.36):
        foot = np.array([0.05 - 0.24 * side, 3.3 + side, 0.30])
        angle = np.linspace(0, 2 * np.pi, 25)
        ring = foot + 0.29 * np.stack([np.cos(angle), 0.25 * np.cos(angle), np.sin(angle)], axis=1)
        wheel += [rod(a, b, 0.018, 6) for a, b in itertools.pairwise(ring)]
        wheel += [rod(foot, place, 0.011, 6) for place in ring[::3]]
    yield Prop(merged(wheel), (0.34, 0.22, 0.14))
    yield Prop(
        merged([rod((-0.35, 3.1, 0.46), (-0.95, 2.3, 0.62), 0.02), rod((-0.3, 3.4, 0.46), (-0.8, 2.2, 0.60), 0.02)]),
        (0.50, 0.36, 0.22),
    )
    can = [(0.12, 0.0), (0.13, 0.30), (0.07, 0.38), (0.075, 0.44), (0.0, 0.44)]
    yield Prop(turned(0.62, 2.25, can), (0.70, 0.74, 0.78), "glossy", 0.12)
    yield Prop(Tube((-0.62, 2.0, 0), (-0.62, 2.0, 0.95), 0.022), (0.34, 0.28, 0.22))
    yield Prop(box(-0.62, 1.97, (0.44, 0.02, 0.30), 8, 0.72), textures.letter(rng, "A", BRIGHT[0], 320))
    yield Prop(Tube((0.95, 3.0, 0), (0.95, 3.0, 0.34), 0.17, 60), textures.label(rng, BRIGHT[2]))
    yield Prop(lid(0.95, 3.0, 0.34, 0.17), (0.30, 0.22, 0.16))


def _trees(rng: np.random.Generator) -> Iterable[Prop]:
    """Poplars at the end of the street and on the hills."""
    trunks, crowns = [], []
    for _ in range(34):
        x, y = rng.uniform(-60, 60), rng.uniform(56, 150)
        if abs(x) < 2.5:
            continue
        base, tall = float(_height(np.array(x), np.array(y))), rng.uniform(5, 10)
        trunks.append(rod((x, y, base - 0.5), (x, y, base + 0.8 * tall), 0.12, 6))
        for share in rng.uniform(0.15, 1.0, 110):
            away, angle = 0.13 * tall * np.sin(np.pi * share**0.8) + 0.1, rng.uniform(0, 2 * np.pi)
            place = (x + away * np.cos(angle), y + away * np.sin(angle), base + share * tall)
            along = rng.normal(size=3) * (0.4, 0.4, 0.9)
            crowns.append(leaf(place, 0.7 * along, np.cross(along, rng.normal(size=3)), 0.5, 0.2, 3))
    yield Prop(merged(trunks), (0.34, 0.27, 0.20))
    yield Prop(merged(crowns), textures.leaf(rng))
