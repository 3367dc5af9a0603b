"""A circuit board and beads from a hand's breadth away: depth of field of a few millimetres. Units are metres."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import disc, rectangle, stroke, text
from dofbench.scenes.procedural.shapes import about_z, blade, box, lid, merged, quad, rod
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "circuit board and beads from a hand's breadth away: macro"
VIEWPOINTS = Viewpoints((0.0, 0.0, 0.072), (0.0, 0.136, 0.002), (0.016, 0.003, 0.010), aim=0.003, focal=1.25, arc=70)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 18])
    lamps = (
        Lamp((-0.20, 0.05, 0.34), (0.0, 0.17, 0.0), 0.10, 30.0),
        Lamp((0.22, 0.30, 0.40), (0.0, 0.24, 0.0), 0.12, 30.0),
        Lamp((-0.06, 0.00, 0.20), (0.0, 0.15, 0.0), 0.012, 260.0),
    )
    return Stage((*_bench(rng), *_board(rng), *_beads(rng)), lamps, 0.30)


def _bench(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-0.6, -0.2, -0.002), (1.2, 0, 0), (0, 0.9, 0), (3, 3)), textures.wood(rng, 1024, 1024, 9))
    yield Prop(quad((-0.5, 0.62, -0.1), (1.0, 0, 0), (0, 0, 0.5)), textures.cells(rng, 640, 896, 110))
    yield Prop(box(-0.10, 0.40, (0.10, 0.03, 0.12), 15), textures.carton(rng))
    yield Prop(box(0.11, 0.42, (0.07, 0.05, 0.09), -20), textures.newspaper(rng))


def _printed(rng: np.random.Generator, size: int = 1536) -> np.ndarray:
    """Tracks, pads and print on green lacquer."""
    lacquer = 0.5 + 0.15 * textures.fractal(rng, size, size, 1.2)
    image = textures.mix((0.05, 0.26, 0.16), (0.10, 0.40, 0.24), lacquer)
    for _ in range(150):
        x, y = rng.uniform(0, size, 2)
        for _ in range(4):
            step = rng.uniform(30, 190) * (1 if rng.random() < 0.5 else -1)
            turn = int(rng.integers(3))
            end = (x + step * (turn != 1), y + step * (turn != 0))
            stroke(image, (x, y), end, 7, (0.20, 0.52, 0.32))
            x, y = end
        disc(image, (x, y), 13, (0.86, 0.74, 0.40))
        disc(image, (x, y), 5, (0.10, 0.10, 0.10))
    for x, y in rng.uniform(0, size, (60, 2)):
        text(image, "".join(rng.choice(list("RCULTX"), 2)), (x, y, 46, 30), (0.92, 0.92, 0.88))
        rectangle(image, (x, y + 38, 52, 4), (0.92, 0.92, 0.88))
    return textures.finish(image)


def _board(rng: np.random.Generator) -> Iterable[Prop]:
    """A board with chips, pins, resistors and capacitors standing on it."""
    yield Prop(box(0.0, 0.165, (0.16, 0.15, 0.0016), 12, -0.0016), _printed(rng))
    feet, about = [], about_z(12)
    for x, y, w, d in ((-0.030, 0.150, 0.022, 0.022), (0.034, 0.178, 0.030, 0.012), (-0.018, 0.208, 0.016, 0.026)):
        print_ = textures.flat(256, 256, (0.09, 0.09, 0.10)) + 0.01 * textures.fractal(rng, 256, 256, 1.0)[..., None]
        text(print_, "LENS", (40, 60, 176, 50), (0.78, 0.78, 0.74))
        text(print_, "".join(rng.choice(list("ABCDEFX"), 5)), (40, 140, 176, 36), (0.78, 0.78, 0.74))
        yield Prop(box(x, y, (w, d, 0.0045), 12, 0.0008), textures.finish(print_), "glossy", 0.2)
        for side in (-1, 1):
            for along in np.linspace(-0.42, 0.42, 9):
                top = about @ (along * w, side * d / 2, 0.0026) + (x, y, 0)
                foot = about @ (along * w, side * (d / 2 + 0.002), 0.0) + (x, y, 0)
                feet.append(rod(top, foot, 0.00035, 6))
    yield Prop(merged(feet), (0.80, 0.80, 0.78))
    pins = [rod((x, y, 0), (x, y, 0.011), 0.0004, 6) for x in np.linspace(-0.016, 0.022, 14) for y in (0.118, 0.1206)]
    yield Prop(merged(pins), (0.86, 0.74, 0.40))
    yield Prop(box(0.003, 0.1193, (0.042, 0.005, 0.0026)), (0.07, 0.07, 0.08))
    for index, (x, y) in enumerate(((0.058, 0.138), (0.066, 0.150), (0.052, 0.232), (-0.058, 0.178), (-0.052, 0.226))):
        yield Prop(Tube((x, y, 0), (x, y, 0.014), 0.0042, 70 * index), textures.label(rng, BRIGHT[index]))
        yield Prop(lid(x, y, 0.014, 0.0042), (0.82, 0.82, 0.80), "metal", 0.2)
    for x, y, turn in ((-0.052, 0.130, 20), (0.010, 0.188, 80), (0.016, 0.145, -30)):
        way = about_z(turn) @ (0.006, 0, 0)
        middle = np.array([x, y, 0.0032])
        a, b = middle - way, middle + way
        yield Prop(Tube((a[0], a[1], a[2]), (b[0], b[1], b[2]), 0.0021), _bands())
        ends = [rod(a, a - 0.7 * way - (0, 0, 0.003), 0.0003, 6), rod(b, b + 0.7 * way - (0, 0, 0.003), 0.0003, 6)]
        yield Prop(merged(ends), (0.80, 0.80, 0.78))


def _bands() -> np.ndarray:
    """A resistor's rings; v along the tube."""
    image = textures.flat(128, 64, (0.80, 0.68, 0.50))
    for row, index in ((20, 0), (44, 5), (66, 1), (104, 7)):
        image[row : row + 10] = BRIGHT[index]
    return textures.finish(image)


def _beads(rng: np.random.Generator) -> Iterable[Prop]:
    """Beads in front, stray hairs of wire over them, and blades of grass standing in between."""
    for index, (x, y) in enumerate(((-0.022, 0.086), (-0.009, 0.082), (0.006, 0.085), (0.018, 0.080), (0.029, 0.088))):
        radius = 0.0042 + 0.0005 * (index % 2)
        skin = textures.cells(rng, 128, 256, 18) if index % 2 else BRIGHT[(2 * index) % 8]
        yield Prop(Sphere((x, y, radius - 0.002), radius, 40.0 * index), skin, "glossy", 0.05)
    hairs = []
    for _ in range(7):
        start = np.array([rng.uniform(-0.04, 0.04), rng.uniform(0.09, 0.12), 0.0])
        bend = np.array([rng.uniform(-0.02, 0.02), rng.uniform(-0.01, 0.03), 0.0])
        spine = [start + t * bend + (0, 0, 0.07 * t * (1 - 0.55 * t)) for t in np.linspace(0, 1, 10)]
        hairs += [rod(a, b, 0.00028, 6) for a, b in itertools.pairwise(spine)]
    yield Prop(merged(hairs), (0.72, 0.30, 0.16))
    blades = [
        blade(
            (x, y, 0.0),
            (rng.uniform(-0.012, 0.012), rng.uniform(-0.006, 0.01)),
            rng.uniform(0.03, 0.05),
            0.0022,
            rng.uniform(-0.4, 0.4),
        )
        for x, y in zip(rng.uniform(-0.05, 0.05, 9), rng.uniform(0.10, 0.24, 9), strict=True)
    ]
    yield Prop(merged(blades), textures.leaf(rng))
