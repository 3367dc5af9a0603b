"""A terrace at night: bulbs, signs and gloss far brighter than white, from near to far."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, merged, quad, rod
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT, night

TITLE = "strings of bulbs at night, up to 60 times white: highlights"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.15), (0.0, 3.4, 0.86), (0.28, 0.05, 0.18), aim=0.06, arc=36)
_WARM, _CHOICE = (1.0, 0.80, 0.52), ((1.0, 0.42, 0.30), (1.0, 0.78, 0.40), (0.45, 0.80, 1.0), (0.60, 1.0, 0.55))


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 13])
    lamps = (Lamp((-1.2, 1.2, 4.2), (0.1, 3.4, 0.3), 0.9, 26.0), Lamp((2.6, 5.6, 4.6), (0.6, 7.6, 0.4), 0.9, 40.0))
    return Stage((*_terrace(rng), *_strings(rng), *_city(rng)), lamps, night(rng))


def _terrace(rng: np.random.Generator) -> Iterable[Prop]:
    yield Prop(quad((-9, -2, 0), (18, 0, 0), (0, 13, 0), (3, 2)), textures.wood(rng, 1024, 1344, 13))
    yield Prop(Tube((-0.55, 2.3, 0), (-0.55, 2.3, 0.62), 0.03), (0.30, 0.30, 0.32))
    yield Prop(box(-0.55, 2.3, (0.62, 0.50, 0.03), 8, 0.62), textures.plaid(rng))
    yield Prop(Sphere((-0.66, 2.22, 0.75), 0.10), (0.80, 0.80, 0.84), "glossy", 0.08)
    yield Prop(Sphere((-0.40, 2.36, 0.73), 0.08), (0.75, 0.10, 0.10), "glossy", 0.06)
    yield Prop(box(0.85, 3.3, (0.5, 0.42, 0.95), -20), textures.poster(rng, 640, 512))
    yield Prop(Sphere((0.10, 3.5, 0.34), 0.34, 60), textures.relief(rng, 512, 1024), "glossy")
    yield Prop(box(-1.5, 4.0, (0.7, 0.5, 0.8), 18), textures.carton(rng))
    yield Prop(box(1.6, 5.2, (0.9, 0.6, 0.7), 30), textures.quilt(rng, 512, 512, 6))


def _strings(rng: np.random.Generator) -> Iterable[Prop]:
    """Four strings of bulbs, each at its own distance, so that bulbs are seen about as large in all."""
    cables = []
    for y, height, sag, half, count in (
        (1.7, 1.36, 0.14, 1.1, 7),
        (2.9, 2.05, 0.22, 1.9, 9),
        (5.0, 1.95, 0.40, 3.2, 11),
        (8.6, 3.9, 0.6, 5.4, 13),
    ):
        x = np.linspace(-half, half, count)
        z = height - sag * (1 - (x / half) ** 2) + rng.uniform(-0.03, 0.03, count)
        depth = y + rng.uniform(-0.12, 0.12, count) * y / 3
        places = np.column_stack([x, depth, z])
        cables += [rod(a + (0, 0, 0.02 * y), b + (0, 0, 0.02 * y), 0.002 * y) for a, b in itertools.pairwise(places)]
        for place in places:
            colour = _WARM if rng.random() < 0.6 else _CHOICE[int(rng.integers(len(_CHOICE)))]
            power = float(np.exp(rng.uniform(np.log(3), np.log(60))))
            yield Prop(Sphere(tuple(place), 0.0085 * y), colour, "lamp", radiance=power)
    yield Prop(merged(cables), (0.10, 0.10, 0.11))
    # A candle and a neon sign: light sources larger than a point.
    yield Prop(Sphere((-0.58, 2.10, 0.72), 0.016), (1.0, 0.72, 0.36), "lamp", radiance=30.0)
    for start, end in (
        ((2.1, 7.4, 1.2), (2.1, 7.4, 1.9)),
        ((2.1, 7.4, 1.9), (2.5, 7.4, 1.2)),
        ((2.5, 7.4, 1.2), (2.5, 7.4, 1.9)),
    ):
        yield Prop(Tube(start, end, 0.035), (1.0, 0.35, 0.55), "lamp", radiance=9.0)


def _city(rng: np.random.Generator) -> Iterable[Prop]:
    """House fronts with lit windows at 11 to 30 units."""
    for x, y, width, height in (
        (-7.5, 12, 4.2, 5.0),
        (-2.8, 16, 4.6, 7.5),
        (3.4, 14, 4.4, 6.2),
        (8.5, 19, 6.0, 9.0),
        (-13, 26, 9.0, 11.0),
        (0.5, 28, 9.0, 12.0),
    ):
        front = textures.mix((0.30, 0.26, 0.24), (0.55, 0.48, 0.42), 0.5 + 0.3 * textures.fractal(rng, 256, 256, 1.3))
        yield Prop(quad((x - width / 2, y, 0), (width, 0, 0), (0, 0, height)), textures.finish(front))
        rows, columns = int(height / 1.1), int(width / 0.9)
        lit = [(c, r) for c in range(columns) for r in range(rows) if rng.random() < 0.34]
        for tone in range(2):
            some = [place for index, place in enumerate(lit) if index % 2 == tone]
            panes = [
                quad((x - width / 2 + 0.25 + 0.9 * c, y - 0.02, 0.45 + 1.1 * r), (0.5, 0, 0), (0, 0, 0.62))
                for c, r in some
            ]
            if panes:
                yield Prop(merged(panes), (_WARM, BRIGHT[4])[tone], "lamp", radiance=(3.0, 1.6)[tone])
