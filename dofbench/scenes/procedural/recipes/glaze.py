"""Glazed pots, cups and plates on a sideboard by a window: rounded gloss with sharp reflections of small lights."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import Colour, stroke
from dofbench.scenes.procedural.shapes import box, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, directions

TITLE = "glazed pots, bowls and plates by a window: gloss"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.18), (0.0, 3.2, 0.48), (0.28, 0.05, 0.18), aim=0.05, arc=44)
_VASE = ((0.13, 0.0), (0.20, 0.10), (0.25, 0.26), (0.22, 0.42), (0.11, 0.56), (0.09, 0.64), (0.13, 0.70), (0.11, 0.70))
_JAR = ((0.16, 0.0), (0.20, 0.04), (0.21, 0.30), (0.16, 0.38), (0.15, 0.42), (0.13, 0.42))
_BOWL = ((0.08, 0.0), (0.09, 0.03), (0.19, 0.10), (0.24, 0.20), (0.25, 0.24), (0.235, 0.24), (0.17, 0.11), (0.0, 0.05))
_CUP = ((0.05, 0.0), (0.06, 0.01), (0.085, 0.08), (0.09, 0.14), (0.082, 0.14), (0.07, 0.06), (0.0, 0.02))


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 22])
    lamps = (
        Lamp((-2.4, 0.8, 3.4), (0.0, 3.2, 0.3), 0.50, 130.0),
        Lamp((1.5, 0.6, 3.0), (0.2, 3.0, 0.2), 0.20, 330.0),
        Lamp((1.2, 5.6, 4.2), (0.0, 7.6, 0.8), 0.8, 90.0),
    )
    return Stage((*_room(rng), *_near(rng), *_pots(rng), *_shelf(rng)), lamps, _windows())


def _windows() -> np.ndarray:
    """A dim room with two windows of four panes, which the glaze reflects."""
    way = directions(256)
    room = 0.12 + 0.12 * np.clip(way[..., 2], 0, 1)
    for around, high, wide, tall, power in ((-2.2, 0.55, 0.34, 0.30, 2.0), (-0.7, 0.50, 0.24, 0.24, 1.5)):
        sideways = np.angle(np.exp(1j * (np.arctan2(way[..., 1], way[..., 0]) - around)))
        upwards = np.arcsin(np.clip(way[..., 2], -1, 1)) - high
        pane = (np.abs(sideways) < wide) & (np.abs(upwards) < tall)
        bars = (np.abs(sideways) < 0.025) | (np.abs(upwards) < 0.025)
        room = room + power * (pane & ~bars)
    return np.asarray(room[..., None] * np.array([1.0, 0.98, 0.93]), np.float32)


def _room(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-6, -1.5, 0), (12, 0, 0), (0, 10, 0), (2, 2)), textures.wood(rng, 1024, 1344, 11))
    yield Prop(quad((-8, 8.4, -1), (16, 0, 0), (0, 0, 7)), textures.relief(rng, 896, 1536))
    yield Prop(quad((-0.75, 1.65, 0.004), (1.7, 0.1, 0), (-0.1, 1.5, 0)), textures.plaid(rng))


def _glazed(rng: np.random.Generator, ground: Colour, other: Colour, drips: bool = True) -> np.ndarray:
    """A glaze that has run down: speckles, a band of the other colour, and drips from it."""
    image = textures.mix(ground, other, 0.22 + 0.20 * textures.fractal(rng, 384, 768, 1.3))
    edge = 90 + 26 * textures.fractal(rng, 1, 768, 1.2)[0]
    rows = np.arange(384)[:, None]
    image[rows < edge] = other
    if drips:
        for x in rng.uniform(0, 768, 26):
            stroke(image, (x, 60), (x, 90 + rng.uniform(20, 150)), rng.uniform(7, 15), other)
    return textures.finish(image + 0.02 * textures.fractal(rng, 384, 768, 1.0)[..., None])


def _painted(rng: np.random.Generator, paint: Colour) -> np.ndarray:
    """White ware with painted strokes."""
    image = textures.flat(256, 512, (0.92, 0.91, 0.88))
    for x in np.linspace(0, 512, 33):
        top = rng.uniform(40, 90)
        stroke(image, (x, top), (x + rng.uniform(-18, 18), top + rng.uniform(50, 110)), rng.uniform(4, 9), paint)
    stroke(image, (0, 24), (512, 24), 8, paint)
    stroke(image, (0, 226), (512, 226), 12, paint)
    return textures.finish(image + 0.012 * textures.fractal(rng, 256, 512, 1.2)[..., None])


def _near(rng: np.random.Generator) -> Iterable[Prop]:
    """Cups, spoons and fruit on the cloth, 1.8 to 2.5 units away."""
    for index, (x, y) in enumerate(((-0.52, 1.95), (-0.16, 2.25), (0.40, 1.90))):
        yield Prop(turned(x, y, _CUP, 0.012), _painted(rng, BRIGHT[(2, 0, 3)[index]]), "glossy", 0.05)
        plate = [(0.0, 0.0), (0.13, 0.0), (0.155, 0.012), (0.0, 0.008)]
        yield Prop(turned(x, y, plate, 0.005), _painted(rng, BRIGHT[(2, 0, 3)[index]]), "glossy", 0.06)
    spoons = [
        rod((x, y, 0.014), (x + 0.20, y + lean, 0.016), 0.007, 10)
        for x, y, lean in ((0.06, 1.86, 0.1), (0.6, 2.1, 0.2))
    ]
    yield Prop(merged(spoons), (0.92, 0.91, 0.88), "metal", 0.12)
    for x, y, radius, colour in ((0.72, 2.42, 0.085, 1), (0.88, 2.32, 0.08, 7), (0.62, 2.55, 0.09, 3)):
        yield Prop(Sphere((x, y, radius + 0.004), radius), BRIGHT[colour], "glossy", 0.14)


def _pots(rng: np.random.Generator) -> Iterable[Prop]:
    """Vases, jars and bowls, 2.8 to 4.6 units away."""
    pots: tuple[tuple[float, float, tuple[tuple[float, float], ...], float, int, int], ...] = (
        (-0.78, 2.95, _VASE, 1.0, 2, 4),
        (0.12, 3.05, _BOWL, 1.1, 0, 6),
        (0.86, 3.3, _JAR, 1.1, 3, 1),
        (-0.28, 3.75, _JAR, 1.2, 5, 4),
        (0.48, 4.1, _VASE, 1.25, 7, 6),
        (-1.35, 4.2, _BOWL, 1.5, 1, 0),
    )
    for x, y, profile, size, ground, other in pots:
        shape = turned(x, y, [(size * r, size * z) for r, z in profile])
        yield Prop(shape, _glazed(rng, BRIGHT[ground], BRIGHT[other]), "glossy", 0.04)


def _shelf(rng: np.random.Generator) -> Iterable[Prop]:
    """Plates that stand on edge and boxes, 5 to 7.5 units away."""
    yield Prop(box(0.0, 6.2, (5.0, 0.7, 0.34), 0, 0.0), textures.wood(rng, 512, 512, 5))
    for x, y, radius, colour in ((-1.7, 6.25, 0.44, 2), (-0.55, 6.2, 0.52, 5), (0.7, 6.3, 0.46, 0), (1.8, 6.2, 0.5, 3)):
        plate = _stood(turned(0, 0, [(0, 0), (0.6 * radius, 0.01), (radius, 0.07), (0.6 * radius, 0.04), (0, 0.03)]))
        shape = Mesh(plate.vertices + (x, y, 0.36 + radius), plate.faces, plate.uv)
        yield Prop(shape, _painted(rng, BRIGHT[colour]), "glossy", 0.05)
    yield Prop(box(-2.6, 5.0, (0.7, 0.5, 0.8), 20), textures.carton(rng), "glossy", 0.12)
    yield Prop(box(2.1, 4.9, (0.7, 0.6, 0.55), -24), textures.quilt(rng, 384, 512, 5), "glossy", 0.10)


def _stood(dish: Mesh) -> Mesh:
    """A flat dish set on edge, its inside towards the cameras."""
    onto = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])
    return Mesh(dish.vertices @ onto.T, dish.faces, dish.uv)
