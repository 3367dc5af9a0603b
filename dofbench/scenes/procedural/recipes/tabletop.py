"""A table in front of a brick wall: the built-in scene.

The table top is z = 0 and the cameras are near (0, 0, 1.1). Content is spread over the whole disparity
range: a lens focused at 0.8, 0.5 or 0.2 of it is sharp at about 2.4, 3.3 or 5.4 units.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import disc
from dofbench.scenes.procedural.shapes import about_z, blade, box, lid, quad, sheet
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Vector, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, fractal

TITLE = "table top with everything: grass, wire rack, print, glossy balls, posters"
# 20 views span 0.53 units, 16 % of the distance to the middle.
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.12), (0.0, 3.4, 0.52), (0.30, 0.05, 0.20), aim=0.06, arc=40)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng(seed)
    lamps = (
        Lamp((-1.6, 0.4, 4.8), (0.1, 3.6, 0.3), 2.6, 10.0),
        Lamp((2.6, 4.6, 5.2), (0.4, 7.2, 0.5), 2.2, 14.0),
        Lamp((-1.7, 0.6, 3.4), (0.1, 3.0, 0.2), 0.22, 190.0),
    )
    return Stage((*_room(rng), *_near(rng), *_middle(rng), *_far(rng)), lamps, 0.28)


def _room(rng: np.random.Generator) -> Iterable[Prop]:
    """Table, wall, and what hangs on the wall."""
    yield Prop(quad((-5.0, -1.0, 0), (10.0, 0, 0), (0, 7.6, 0)), textures.wood(rng, 1024, 1344, 13))
    yield Prop(quad((-7.5, 8.8, -3.0), (15.0, 0, 0), (0, 0, 9.0)), textures.bricks(rng, 1024, 1706, 26))
    for left, bottom, width, height, picture in (
        (-4.6, 0.75, 1.5, 2.1, textures.poster(rng)),
        (-2.6, 1.15, 2.4, 1.72, textures.relief(rng)),
        (0.35, 0.95, 2.1, 1.6, textures.cells(rng)),
        (2.9, 0.55, 1.7, 2.3, textures.quilt(rng, 640, 480, 7)),
    ):
        yield Prop(box(left + width / 2, 8.76, (width + 0.12, 0.06, height + 0.12), base=bottom - 0.06), textures.INK)
        yield Prop(quad((left, 8.72, bottom), (width, 0, 0), (0, 0, height)), picture)


def _near(rng: np.random.Generator) -> Iterable[Prop]:
    """About 1.9 to 2.8 units away: cloth, newspaper, a pot of grass, a wire rack, a pencil, a die."""
    yield Prop(sheet(-0.95, 2.15, 1.15, 1.0, 12, 0.004), textures.plaid(rng))
    yield Prop(sheet(0.28, 2.22, 0.62, 0.80, -9, 0.006), textures.newspaper(rng))
    yield Prop(Tube((-0.86, 2.3, 0), (-0.86, 2.3, 0.34), 0.19, 200), textures.label(rng, BRIGHT[7]))
    yield Prop(lid(-0.86, 2.3, 0.30, 0.19), (0.24, 0.17, 0.12))
    for angle in rng.uniform(0, 2 * np.pi, 26):
        r = 0.15 * np.sqrt(rng.uniform())
        reach = rng.uniform(0.08, 0.42)
        root = (-0.86 + r * np.cos(angle), 2.3 + r * np.sin(angle), 0.29)
        lean = (reach * np.cos(angle), 0.6 * reach * np.sin(angle))
        shape = blade(root, lean, rng.uniform(0.45, 1.0), rng.uniform(0.022, 0.042), rng.uniform(-0.5, 0.5))
        yield Prop(shape, textures.leaf(rng))
    yield from _rack(rng, 0.98, 2.42, 24)
    yield Prop(Tube((0.05, 2.02, 0.022), (0.60, 1.93, 0.022), 0.016), BRIGHT[1])
    yield Prop(box(-0.26, 2.12, (0.13, 0.13, 0.13), 31), textures.quilt(rng, 192, 192, 3))
    yield Prop(Sphere((0.66, 2.26, 0.09), 0.08, 40), textures.cells(rng, 256, 512, 60))


def _rack(rng: np.random.Generator, x: float, y: float, turn: float) -> Iterable[Prop]:
    """A wire rack of thin rods, with tags on it."""

    def at(u: float, z: float) -> Vector:
        px, py, _ = about_z(turn) @ (u, 0, 0) + (x, y, 0)
        return float(px), float(py), z

    for u in np.linspace(-0.36, 0.36, 7):
        yield Prop(Tube(at(u, 0.0), at(u, 0.86), 0.0075), (0.80, 0.80, 0.78))
    for z in np.linspace(0.10, 0.86, 5):
        yield Prop(Tube(at(-0.37, z), at(0.37, z), 0.0065), (0.30, 0.32, 0.36))
    for u, z, glyph in ((-0.24, 0.46, "F"), (0.02, 0.24, "A"), (0.13, 0.62, "K")):
        left, right = at(u, z), at(u + 0.15, z)
        tag = quad((left[0], left[1] - 0.012, z), np.subtract(right, left), (0, 0, 0.17))
        yield Prop(tag, textures.letter(rng, glyph, BRIGHT[int(rng.integers(4))]))


def _middle(rng: np.random.Generator) -> Iterable[Prop]:
    """About 2.9 to 4.2 units away: a printed box, a globe, glossy balls, a tin, toy blocks."""
    yield Prop(box(-0.42, 3.45, (0.56, 0.24, 0.86), -14), textures.carton(rng))
    yield Prop(Sphere((0.40, 3.35, 0.42), 0.34, 70), textures.relief(rng, 512, 1024))
    yield Prop(Tube((0.40, 3.35, 0), (0.40, 3.35, 0.09), 0.17), (0.35, 0.22, 0.14))
    yield Prop(lid(0.40, 3.35, 0.09, 0.17), (0.35, 0.22, 0.14))
    yield Prop(Sphere((-0.02, 2.95, 0.17), 0.17), (0.78, 0.13, 0.12), "glossy")
    yield Prop(Sphere((0.95, 3.05, 0.13), 0.13), (0.90, 0.62, 0.16), "glossy")
    yield Prop(Tube((1.28, 3.6, 0), (1.28, 3.6, 0.52), 0.2, 150), textures.label(rng, BRIGHT[2]))
    yield Prop(lid(1.28, 3.6, 0.52, 0.2), (0.72, 0.72, 0.70))
    for x, y, z, turn, glyph, colour in (
        (-1.55, 3.35, 0.0, 12, "D", 0),
        (-1.22, 3.45, 0.0, -20, "O", 2),
        (-1.39, 3.40, 0.27, 5, "F", 3),
        (0.85, 4.0, 0.0, 35, "R", 5),
        (1.85, 3.9, 0.0, -15, "M", 0),
        (-1.95, 3.85, 0.0, 40, "Q", 7),
    ):
        yield Prop(box(x, y, (0.27, 0.27, 0.27), turn, z), textures.letter(rng, glyph, BRIGHT[colour]))
    yield Prop(box(0.62, 2.88, (0.10, 0.10, 0.10), 18), textures.quilt(rng, 160, 160, 2))


def _far(rng: np.random.Generator) -> Iterable[Prop]:
    """About 4.4 to 6.4 units away: books, a vase, stacked boxes, a framed picture, a stone ball."""
    x = -2.75
    while x < -0.75:
        thick, tall = rng.uniform(0.14, 0.26), rng.uniform(0.85, 1.35)
        colour = BRIGHT[int(rng.integers(len(BRIGHT)))]
        yield Prop(
            box(x + thick / 2, 5.3, (thick - 0.012, 0.7, tall), rng.uniform(-1.5, 1.5)), textures.spine(rng, colour)
        )
        x += thick
    yield Prop(Tube((0.05, 5.2, 0), (0.05, 5.2, 1.05), 0.3, 90), _pebbles(rng, 512, 896, 240))
    yield Prop(lid(0.05, 5.2, 1.05, 0.3), textures.marble(rng, 256, 256))
    yield Prop(Sphere((0.05, 5.2, 1.32), 0.27, 20), textures.quilt(rng, 384, 768, 7))
    yield Prop(box(1.55, 5.1, (0.8, 0.7, 0.62), 22), textures.plaid(rng, 512, 512))
    yield Prop(box(1.5, 5.15, (0.55, 0.5, 0.42), -10, 0.62), textures.poster(rng, 512, 640))
    yield Prop(Sphere((1.5, 5.15, 1.25), 0.21), textures.marble(rng))
    yield Prop(box(2.75, 5.9, (1.05, 0.08, 1.3), -20), textures.cells(rng, 640, 512, 70))
    yield Prop(box(-3.35, 5.6, (0.6, 0.6, 0.6), 30), textures.carton(rng))
    yield Prop(Sphere((0.85, 5.75, 0.3), 0.3), textures.relief(rng, 384, 768))
    yield Prop(box(-0.35, 6.1, (0.5, 0.3, 0.75), 8), textures.cells(rng, 384, 256, 50))


def _pebbles(rng: np.random.Generator, height: int, width: int, count: int) -> np.ndarray:
    """Terrazzo: coloured chips in pale stone."""
    image = textures.flat(height, width, (0.82, 0.79, 0.74)) + 0.02 * fractal(rng, height, width, 1.2)[..., None]
    for x, y in rng.uniform(0, 1, (count, 2)) * (width, height):
        disc(image, (x, y), rng.uniform(6, 22), textures.some(rng))
    return textures.finish(image)
