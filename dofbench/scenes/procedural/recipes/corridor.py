"""A plain painted room: walls, floor and ceiling without texture, and only a few things to tell depth by."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, lid, merged, quad
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "plain painted room: walls and solids without texture"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.10), (0.0, 3.4, 0.70), (0.28, 0.05, 0.18), aim=0.05, arc=26)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 14])
    lamps = (
        Lamp((-0.6, 1.4, 2.9), (0.0, 3.2, 0.0), 0.8, 34.0),
        Lamp((0.8, 5.6, 2.9), (0.0, 6.6, 0.0), 0.8, 34.0),
        Lamp((1.4, 0.2, 2.5), (-0.4, 3.2, 0.4), 0.3, 60.0),
    )
    return Stage((*_room(), *_solids(rng)), lamps, 0.0)


def _room() -> Iterable[Prop]:
    white, floor, trim = (0.88, 0.87, 0.84), (0.62, 0.58, 0.54), (0.42, 0.30, 0.22)
    yield Prop(quad((-2.4, -2, 0), (4.8, 0, 0), (0, 11, 0)), floor)
    yield Prop(quad((-2.4, -2, 3.0), (0, 11, 0), (4.8, 0, 0)), white)
    yield Prop(quad((-2.4, -2, 0), (0, 11, 0), (0, 0, 3.0)), (0.80, 0.86, 0.88))
    yield Prop(quad((2.4, 9, 0), (0, -11, 0), (0, 0, 3.0)), (0.88, 0.82, 0.72))
    yield Prop(quad((-2.4, 9, 0), (4.8, 0, 0), (0, 0, 3.0)), white)
    yield Prop(quad((2.4, -2, 0), (-4.8, 0, 0), (0, 0, 3.0)), white)
    boards = [box(-2.385, 3.5, (0.03, 11, 0.1)), box(2.385, 3.5, (0.03, 11, 0.1)), box(0, 8.985, (4.8, 0.03, 0.1))]
    # A door at the end and two openings in the side walls, as frames and panels.
    frames = [box(0.4, 8.96, (1.1, 0.06, 2.2)), box(-2.37, 5.4, (0.06, 1.1, 2.2)), box(2.37, 4.2, (0.06, 1.1, 2.2))]
    yield Prop(merged([*boards, *frames]), trim)
    yield Prop(merged([box(0.4, 8.92, (0.9, 0.06, 2.1)), box(-2.34, 5.4, (0.06, 0.9, 2.1))]), (0.70, 0.60, 0.46))
    yield Prop(Sphere((0.08, 8.86, 1.05), 0.035), (0.85, 0.70, 0.35), "metal", 0.15)


def _solids(rng: np.random.Generator) -> Iterable[Prop]:
    """Solids of one colour each, and three printed things."""
    yield Prop(box(-0.72, 2.5, (0.42, 0.42, 0.42), 24), BRIGHT[2])
    yield Prop(Sphere((-0.68, 2.48, 0.60), 0.18), BRIGHT[1])
    yield Prop(Sphere((0.18, 2.3, 0.16), 0.16), BRIGHT[0], "glossy")
    yield Prop(Tube((0.85, 2.9, 0), (0.85, 2.9, 0.8), 0.16), BRIGHT[3])
    yield Prop(lid(0.85, 2.9, 0.8, 0.16), BRIGHT[3])
    yield Prop(box(0.1, 3.9, (0.36, 0.36, 0.95), -30), (0.92, 0.90, 0.86))
    yield Prop(box(-1.55, 4.7, (0.6, 0.6, 0.75), 10), BRIGHT[7])
    yield Prop(Sphere((1.3, 5.2, 0.4), 0.4), (0.90, 0.88, 0.84))
    yield Prop(box(-0.9, 7.0, (0.8, 0.5, 1.2), -14), BRIGHT[5])
    yield Prop(Tube((1.5, 7.6, 0), (1.5, 7.6, 1.5), 0.2), BRIGHT[6])
    yield Prop(quad((-2.36, 2.9, 1.1), (0, 0.9, 0), (0, 0, 0.7)), textures.cells(rng, 448, 576, 60))
    yield Prop(quad((-1.7, 8.96, 1.0), (1.2, 0, 0), (0, 0, 0.9)), textures.relief(rng))
    yield Prop(box(0.1, 3.9, (0.24, 0.18, 0.03), 12, 0.95), textures.spine(rng, BRIGHT[0]))
