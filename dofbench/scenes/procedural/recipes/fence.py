"""A chain-link fence close to the camera, in front of a yard and a far wall: thin structures over everything."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, lid, merged, quad, rod
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "chain-link fence in front of a yard and a far wall: thin structures"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.10), (0.0, 3.4, 0.80), (0.28, 0.05, 0.18), aim=0.06, arc=30)
_FENCE = 1.55  # distance
_MESH = 0.125  # diagonal pitch


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 11])
    lamps = (Lamp((-3.5, -1.0, 6.5), (0.0, 4.0, 0.5), 2.4, 22.0), Lamp((4.5, 5.0, 7.5), (0.5, 9.5, 1.2), 2.0, 34.0))
    return Stage((*_ground_and_wall(rng), *_fence(rng), *_yard(rng)), lamps, 0.35)


def _ground_and_wall(rng: np.random.Generator) -> Iterable[Prop]:
    paving = textures.mix((0.42, 0.40, 0.38), (0.78, 0.74, 0.68), 0.5 + 0.25 * textures.fractal(rng, 1024, 1024, 1.1))
    yield Prop(quad((-14, -2, 0), (28, 0, 0), (0, 28, 0), (4, 4)), textures.finish(paving))
    yield Prop(quad((-16, 11.5, 0), (32, 0, 0), (0, 0, 9), (2, 1)), textures.bricks(rng, 1024, 1706, 30))
    for x, picture in ((-5.2, textures.poster(rng)), (-1.0, textures.cells(rng)), (3.6, textures.relief(rng))):
        yield Prop(quad((x, 11.4, 0.9), (2.6, 0, 0), (0, 0, 2.0)), picture)


def _fence(rng: np.random.Generator) -> Iterable[Prop]:
    """Two sets of straight wires, woven a wire's width apart, with a rail and two posts."""
    width, height, wires = 3.4, 1.75, []
    for start in np.arange(-width / 2 - height, width / 2, _MESH):
        for lean, offset in ((1, 0.0), (-1, 0.013)):
            low, high = np.array([start, 0.0]), np.array([start + height, height])
            if lean < 0:
                low[0], high[0] = -low[0], -high[0]
            inside = np.clip(np.array([low[0], high[0]]), -width / 2, width / 2)
            if inside[0] == inside[1]:
                continue
            rise = np.abs(inside - low[0])
            ends = [(x, _FENCE + offset, z) for x, z in zip(inside, rise, strict=True)]
            wires.append(rod(ends[0], ends[1], 0.0055))
    yield Prop(merged(wires), (0.62, 0.66, 0.68))
    yield Prop(Tube((-1.75, _FENCE, 1.76), (1.75, _FENCE, 1.76), 0.02), (0.36, 0.44, 0.40))
    for x in (-0.98, 0.94):
        yield Prop(Tube((x, _FENCE + 0.03, 0), (x, _FENCE + 0.03, 1.8), 0.026), (0.30, 0.42, 0.36))
    sign = textures.letter(rng, "K", BRIGHT[0])
    yield Prop(quad((0.34, _FENCE - 0.02, 0.62), (0.24, 0, 0), (0, 0, 0.24)), sign)


def _yard(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(box(-0.55, 3.3, (0.62, 0.3, 0.9), -16), textures.carton(rng))
    yield Prop(Sphere((0.42, 3.5, 0.36), 0.36, 30), textures.quilt(rng, 512, 1024, 6))
    yield Prop(Sphere((1.45, 4.3, 0.28), 0.28), (0.82, 0.20, 0.14), "glossy")
    yield Prop(Tube((-1.9, 5.2, 0), (-1.9, 5.2, 1.2), 0.34, 20), textures.label(rng, BRIGHT[2]))
    yield Prop(lid(-1.9, 5.2, 1.2, 0.34), (0.7, 0.7, 0.68))
    yield Prop(box(2.5, 6.4, (1.3, 0.9, 1.1), 24), textures.plaid(rng))
    yield Prop(box(0.2, 7.2, (0.9, 0.6, 1.5), -9), textures.newspaper(rng))
    yield Prop(box(-3.8, 8.4, (1.4, 1.0, 1.9), 15), textures.cells(rng, 640, 640, 80))
    # Bare saplings: twigs that are thin at every distance.
    twigs = []
    for x, y in ((-0.1, 4.9), (1.9, 8.5), (-2.9, 6.6)):
        twigs.append(rod((x, y, 0), (x, y, 1.9), 0.022))
        for z in rng.uniform(0.7, 1.9, 9):
            reach, angle = rng.uniform(0.25, 0.55), rng.uniform(0, 2 * np.pi)
            tip = (x + reach * np.cos(angle), y + reach * np.sin(angle), z + rng.uniform(0.1, 0.4))
            twigs.append(rod((x, y, z), tip, 0.009))
    yield Prop(merged(twigs), (0.30, 0.21, 0.14))
