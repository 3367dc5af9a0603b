"""An attic of plain plaster under a sloping roof: large surfaces of one colour that lean, with a few things in it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.shapes import box, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Tube, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "plastered attic under a sloping roof: walls and furniture without texture"
VIEWPOINTS = Viewpoints((0.0, 0.0, 1.12), (0.0, 3.4, 0.76), (0.28, 0.05, 0.18), aim=0.05, arc=26)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 24])
    # Each hangs below the slopes of the roof, above what the cameras see.
    lamps = (
        Lamp((0.35, 0.6, 2.35), (-0.2, 3.2, 0.2), 0.6, 60.0),
        Lamp((-0.25, 2.9, 2.45), (0.4, 6.8, 0.4), 0.6, 90.0),
        Lamp((-1.20, 0.3, 1.70), (0.4, 3.0, 0.4), 0.3, 90.0),
    )
    return Stage((*_shell(), *_beams(), *_furniture(rng)), lamps, 0.04)


def _shell() -> Iterable[Prop]:
    """Floor, low walls, two slopes that meet at the ridge, gable, and a stair's parapet."""
    plaster, slope, floor = (0.90, 0.88, 0.83), (0.86, 0.87, 0.90), (0.56, 0.48, 0.42)
    yield Prop(quad((-2.6, -2, 0), (5.2, 0, 0), (0, 11, 0)), floor)
    yield Prop(quad((-2.6, -2, 0), (0, 11, 0), (0, 0, 1.0)), plaster)
    yield Prop(quad((2.6, 9, 0), (0, -11, 0), (0, 0, 1.0)), plaster)
    yield Prop(quad((-2.6, -2, 1.0), (0, 11, 0), (2.6, 0, 1.9)), slope)
    yield Prop(quad((2.6, 9, 1.0), (0, -11, 0), (-2.6, 0, 1.9)), (0.90, 0.86, 0.86))
    yield Prop(quad((-2.6, 9, 0), (5.2, 0, 0), (0, 0, 3.0)), (0.80, 0.76, 0.68))
    yield Prop(quad((2.6, -2, 0), (-5.2, 0, 0), (0, 0, 3.0)), plaster)
    yield Prop(box(-1.35, 5.6, (1.3, 0.1, 0.85)), (0.88, 0.86, 0.82))
    yield Prop(merged(box(-1.35, 6.2 + 0.3 * i, (1.2, 0.3, 0.5 - 0.12 * i)) for i in range(4)), (0.72, 0.66, 0.58))


def _beams() -> Iterable[Prop]:
    """Three trusses of smooth timber, a rail, and a round window in the gable."""
    timber = (0.50, 0.36, 0.25)
    for y in (2.7, 5.2, 7.7):
        parts = [box(x, y, (0.12, 0.12, 1.0)) for x in (-2.5, 2.5)]
        yield Prop(merged([*parts, box(0, y, (3.6, 0.12, 0.12), 0, 2.0)]), timber)
    yield Prop(Tube((1.15, 4.9, 0.9), (2.55, 4.9, 0.9), 0.03), timber)
    rails = [rod((x, 4.9, 0), (x, 4.9, 0.9), 0.018) for x in np.linspace(1.2, 2.5, 6)]
    yield Prop(merged(rails), (0.86, 0.84, 0.80))
    window = [(0.0, 0.0), (0.42, 0.0), (0.42, 0.02)]
    frame = turned(0, 0, window, 0.0, 40)
    onto = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])
    yield Prop(Mesh(frame.vertices @ onto.T + (0.1, 8.96, 1.75), frame.faces, frame.uv), (0.62, 0.74, 0.84))


def _furniture(rng: np.random.Generator) -> Iterable[Prop]:
    """Things of one colour each from near to far, and two with print on them."""
    yield Prop(Sphere((-0.46, 1.95, 0.16), 0.16), BRIGHT[7])
    yield Prop(box(0.42, 2.15, (0.30, 0.30, 0.30), 32), (0.40, 0.56, 0.52))
    yield Prop(turned(0.42, 2.15, [(0.05, 0), (0.08, 0.04), (0.06, 0.16), (0.03, 0.22)], 0.30), BRIGHT[0], "glossy")
    yield Prop(merged([box(-0.2, 3.0, (0.72, 0.48, 0.06), 10, 0.46), *_legs(-0.2, 3.0)]), (0.78, 0.62, 0.44))
    yield Prop(turned(-0.30, 3.0, [(0.10, 0), (0.13, 0.10), (0.08, 0.24), (0.05, 0.30)], 0.52), BRIGHT[2], "glossy")
    yield Prop(box(0.02, 2.98, (0.16, 0.12, 0.05), -20, 0.52), BRIGHT[5])
    yield Prop(box(1.05, 3.7, (0.62, 0.42, 0.48), -16), (0.44, 0.30, 0.34))
    yield Prop(Tube((1.05, 3.42, 0.30), (1.05, 3.40, 0.30), 0.05), (0.85, 0.72, 0.36), "metal", 0.15)
    yield Prop(Sphere((-1.2, 4.1, 0.34), 0.34), BRIGHT[3])
    yield Prop(box(0.35, 5.2, (0.9, 0.5, 0.7), 12), BRIGHT[6])
    yield Prop(turned(0.30, 5.2, [(0.16, 0), (0.06, 0.06), (0.05, 0.36), (0.24, 0.40), (0.14, 0.64)], 0.7), BRIGHT[4])
    yield Prop(box(1.7, 6.5, (0.8, 0.7, 1.1), -24), BRIGHT[1])
    yield Prop(Sphere((-0.3, 6.9, 0.45), 0.45), (0.88, 0.85, 0.80))
    yield Prop(box(0.9, 8.3, (0.9, 0.4, 1.3), 8), (0.58, 0.40, 0.30))
    yield Prop(box(0.28, 3.85, (0.42, 0.06, 0.56), -8), textures.carton(rng))
    yield Prop(quad((-1.9, 8.94, 0.9), (0.9, 0, 0), (0, 0, 0.7)), textures.relief(rng, 448, 576))


def _legs(x: float, y: float) -> Iterable[Mesh]:
    return (box(x + u, y + v, (0.05, 0.05, 0.46), 10) for u in (-0.3, 0.3) for v in (-0.18, 0.18))
