"""A shed with bicycle wheels, a wire basket and bare twigs: thin structures at every distance."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import about_z, box, lid, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "bicycle wheels, wire baskets and bare twigs in a shed: thin structures"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.05), (0.0, 3.3, 0.70), (0.28, 0.05, 0.18), aim=0.05, arc=32)
_SPOKES = 28


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 21])
    lamps = (Lamp((-2.6, 0.0, 5.0), (0.0, 3.0, 0.5), 1.6, 26.0), Lamp((2.8, 4.6, 5.6), (0.0, 7.4, 0.8), 1.8, 34.0))
    return Stage((*_shed(rng), *_wheels(rng), *_baskets(rng), *_twigs(rng)), lamps, 0.30)


def _shed(rng: np.random.Generator) -> Iterable[Prop]:
    concrete = textures.mix((0.40, 0.40, 0.38), (0.74, 0.73, 0.69), 0.5 + 0.24 * textures.fractal(rng, 1024, 1024, 1.2))
    yield Prop(quad((-7, -1.5, 0), (14, 0, 0), (0, 11.5, 0), (3, 2)), textures.finish(concrete))
    boards = np.ascontiguousarray(np.rot90(textures.wood(rng, 1536, 1024, 22)))
    yield Prop(quad((-7, 8.6, 0), (14, 0, 0), (0, 0, 6)), boards)
    for x, picture in ((-3.4, textures.relief(rng)), (0.7, textures.newspaper(rng, 768, 896))):
        yield Prop(quad((x, 8.55, 1.0), (2.0, 0, 0), (0, 0, 1.5)), picture)
    yield Prop(box(2.2, 6.3, (1.3, 0.6, 0.9), -18), textures.carton(rng))
    yield Prop(box(-2.6, 5.9, (1.1, 0.7, 0.7), 22), textures.plaid(rng))
    yield Prop(Tube((0.35, 5.3, 0), (0.35, 5.3, 0.62), 0.24, 70), textures.label(rng, BRIGHT[3]))
    yield Prop(lid(0.35, 5.3, 0.62, 0.24), (0.68, 0.68, 0.66))
    # Tools that hang at the wall, each on a long thin handle.
    handles = [
        rod((x, 8.4, z), (x + lean, 8.35, z + 1.5), 0.025) for x, z, lean in ((-1.1, 0.3, 0.1), (3.2, 0.2, -0.2))
    ]
    yield Prop(merged(handles), (0.66, 0.48, 0.28))


def _ring(centre: np.ndarray, across: np.ndarray, up: np.ndarray, radius: float, wire: float) -> Mesh:
    """A hoop of wire about `centre`, in the plane of the unit vectors `across` and `up`."""
    angle = np.linspace(0, 2 * np.pi, 49)
    places = centre + radius * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up)
    return merged(rod(a, b, wire, 6) for a, b in itertools.pairwise(places))


def _wheels(rng: np.random.Generator) -> Iterable[Prop]:
    """Three wheels that stand one behind the other: tyre, rim, hub, and spokes that cross."""
    up = np.array([0.0, 0.0, 1.0])
    for (x, y), radius, turn, tyre in (
        ((-0.42, 1.95), 0.40, 14, (0.12, 0.12, 0.13)),
        ((0.62, 3.1), 0.46, -22, BRIGHT[6]),
        ((-0.95, 4.7), 0.52, 30, (0.34, 0.16, 0.12)),
    ):
        across = about_z(turn) @ (1.0, 0.0, 0.0)
        axle = np.cross(across, up)
        centre = np.array([x, y, radius + 0.02])
        spokes = []
        for index, angle in enumerate(np.arange(_SPOKES) * 2 * np.pi / _SPOKES + rng.uniform(0, 0.2)):
            side, lean = (-1) ** index, 0.55 * (-1) ** (index // 2)
            out = np.cos(angle) * across + np.sin(angle) * up
            start = np.cos(angle + lean) * across + np.sin(angle + lean) * up
            spokes.append(rod(centre + 0.03 * start + 0.03 * side * axle, centre + 0.93 * radius * out, 0.0030, 5))
        yield Prop(merged(spokes), (0.82, 0.83, 0.84))
        yield Prop(_ring(centre, across, up, radius, 0.020), tyre)
        yield Prop(_ring(centre, across, up, 0.94 * radius, 0.011), (0.76, 0.76, 0.78))
        ends = [(float(p[0]), float(p[1]), float(p[2])) for p in (centre - 0.045 * axle, centre + 0.045 * axle)]
        yield Prop(Tube(ends[0], ends[1], 0.026), (0.55, 0.56, 0.58))


def _baskets(rng: np.random.Generator) -> Iterable[Prop]:
    """Two baskets of bent wire, with things in them that show through."""
    flat = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    for x, y, low, high, tall, count in ((0.30, 2.15, 0.15, 0.24, 0.30, 22), (1.35, 4.3, 0.26, 0.40, 0.52, 26)):
        wires = []
        for angle in np.arange(count) * 2 * np.pi / count:
            way = np.array([np.cos(angle), np.sin(angle), 0.0])
            foot = np.array([x, y, 0.012])
            wires.append(rod(foot + low * way, foot + high * way + (0, 0, tall), 0.0035, 5))
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            middle = np.array([x, y, 0.012 + share * tall])
            wires.append(_ring(middle, *flat, low + share * (high - low), 0.0045))
        yield Prop(merged(wires), textures.BRIGHT[int(rng.integers(4))])
        inside = [(0.4 * low, 0.0), (0.72 * low, 0.18 * tall), (0.66 * low, 0.62 * tall), (0.2 * low, 0.72 * tall)]
        yield Prop(turned(x, y, inside, 0.03), textures.quilt(rng, 256, 512, 4))


def _twigs(rng: np.random.Generator) -> Iterable[Prop]:
    """Bare branches in two jugs; every twig forks twice."""
    for x, y, tall in ((1.02, 2.5, 0.95), (-1.75, 3.6, 1.35)):
        jug = [(0.11, 0.0), (0.15, 0.12), (0.12, 0.26), (0.08, 0.34), (0.10, 0.38)]
        yield Prop(turned(x, y, jug), textures.cells(rng, 256, 512, 60))
        twigs = []
        for _ in range(7):
            way = rng.normal(size=3) * (0.34, 0.22, 0.0) + (0, 0, 1.0)
            twigs += _fork(rng, np.array([x, y, 0.30]), way / np.linalg.norm(way), tall, 0.010, 3)
        yield Prop(merged(twigs), (0.33, 0.23, 0.15))


def _fork(
    rng: np.random.Generator, root: np.ndarray, way: np.ndarray, length: float, thick: float, forks: int
) -> list[Mesh]:
    tip = root + 0.55 * length * way
    found = [rod(root, tip, thick, 5)]
    for _ in range(2 if forks > 1 else 0):
        turn = way + 0.45 * rng.normal(size=3)
        found += _fork(rng, tip, turn / np.linalg.norm(turn), 0.7 * length, 0.66 * thick, forks - 1)
    return found
