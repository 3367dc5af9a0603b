"""Branches with leaves right in front of the camera hide part of what stands behind them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import Colour
from dofbench.scenes.procedural.shapes import box, leaf, lid, merged, quad, rod
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Tube, Viewpoints

TITLE = "leaves that hide part of the subject: foreground occlusion"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.00), (0.0, 3.0, 0.72), (0.26, 0.05, 0.18), aim=0.05, arc=36)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 12])
    lamps = (Lamp((-2.4, 0.2, 5.2), (0.0, 2.4, 0.6), 1.8, 24.0), Lamp((3.2, 4.2, 6.0), (0.2, 7.6, 1.0), 2.2, 26.0))
    return Stage((*_room(rng), *_branches(rng), *_subject(rng)), lamps, 0.32)


def _room(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-8, -1.5, 0), (16, 0, 0), (0, 14, 0), (2, 2)), textures.wood(rng, 1024, 1344, 13))
    yield Prop(quad((-9, 9.6, 0), (18, 0, 0), (0, 0, 8)), textures.bricks(rng, 1024, 1706, 22))
    yield Prop(quad((-3.6, 9.5, 0.9), (2.6, 0, 0), (0, 0, 1.9)), textures.relief(rng))
    yield Prop(quad((0.9, 9.5, 0.7), (2.2, 0, 0), (0, 0, 2.4)), textures.poster(rng))


def _branches(rng: np.random.Generator) -> Iterable[Prop]:
    """Twigs that hang and stand into the picture from its left, right and top, 1.1 to 1.9 units away."""
    twigs: list[Mesh] = []
    kinds: list[list[Mesh]] = [[], [], []]
    for root, tip in (
        ((-1.25, 1.35, 0.30), (-0.10, 1.50, 0.92)),
        ((-1.2, 1.70, 1.65), (-0.15, 1.60, 1.05)),
        ((1.3, 1.50, 1.55), (0.38, 1.40, 1.02)),
        ((1.2, 1.25, 0.25), (0.50, 1.30, 0.80)),
        ((0.15, 1.80, 1.95), (0.02, 1.70, 1.22)),
        ((-1.3, 1.9, 0.9), (-0.45, 1.85, 0.72)),
    ):
        a, b = np.array(root), np.array(tip)
        bow = np.array([0.0, 0.0, 0.12])
        spine = [a + t * (b - a) + 4 * t * (1 - t) * bow for t in np.linspace(0, 1, 9)]
        twigs += [rod(p, q, 0.010 * (1 - 0.08 * i)) for i, (p, q) in enumerate(itertools.pairwise(spine))]
        for _ in range(34):
            t = rng.uniform(0.12, 1.0)
            place = a + t * (b - a) + 4 * t * (1 - t) * bow
            along = rng.normal(size=3) * (1, 0.6, 1) + 0.5 * (b - a) / np.linalg.norm(b - a)
            along *= rng.uniform(0.10, 0.21) / np.linalg.norm(along)
            normal = np.cross(along, rng.normal(size=3) + (0, 0, 0.01))
            kinds[int(rng.integers(3))].append(leaf(place, along, normal, rng.uniform(0.05, 0.085)))
    yield Prop(merged(twigs), (0.34, 0.24, 0.15))
    for leaves, (dark, light) in zip(
        kinds,
        (
            ((0.16, 0.38, 0.12), (0.56, 0.74, 0.30)),
            ((0.30, 0.42, 0.10), (0.80, 0.80, 0.36)),
            ((0.50, 0.20, 0.10), (0.92, 0.56, 0.22)),
        ),
        strict=True,
    ):
        yield Prop(merged(leaves), _veined(rng, dark, light))


def _veined(rng: np.random.Generator, dark: Colour, light: Colour) -> np.ndarray:
    """A leaf's face: a pale midrib with side veins on mottled green; u across, v from root to tip."""
    rows, columns = np.mgrid[0:256, 0:128]
    across = np.abs(columns / 127 - 0.5) * 2
    veins = 0.5 + 0.5 * np.cos((rows - 60 * across) * 2 * np.pi / 26)
    weight = 0.35 + 0.35 * veins**8 + 0.6 * (across < 0.06) + 0.16 * textures.fractal(rng, 256, 128, 1.2)
    return textures.finish(textures.mix(dark, light, weight))


def _subject(rng: np.random.Generator) -> Iterable[Prop]:
    """A bust of simple forms on a printed plinth, with things beside and behind it."""
    yield Prop(box(0.0, 3.1, (0.66, 0.5, 0.42), 12), textures.carton(rng))
    yield Prop(Tube((0.0, 3.1, 0.42), (0.0, 3.1, 0.66), 0.12), textures.marble(rng))
    yield Prop(Sphere((0.0, 3.1, 0.90), 0.27, 40), textures.cells(rng, 512, 1024, 90))
    yield Prop(box(-1.0, 3.7, (0.5, 0.4, 0.9), 22), textures.newspaper(rng))
    yield Prop(Tube((0.98, 3.5, 0), (0.98, 3.5, 0.72), 0.22, 120), textures.label(rng, textures.BRIGHT[5]))
    yield Prop(lid(0.98, 3.5, 0.72, 0.22), (0.7, 0.7, 0.66))
    yield Prop(box(1.9, 5.4, (0.9, 0.7, 1.2), -20), textures.quilt(rng, 640, 512, 6))
    yield Prop(box(-2.3, 6.0, (1.0, 0.8, 1.4), 14), textures.plaid(rng))
    yield Prop(Sphere((0.5, 6.6, 0.5), 0.5, 10), textures.relief(rng, 512, 1024))
