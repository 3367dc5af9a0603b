"""Two walls seen through a lens, from which the tests' folders of ground truth are made."""

from __future__ import annotations

from functools import cache

import numpy as np

from dofbench.evaluation.renderer import planes
from dofbench.evaluation.renderer.lens_points import lens_points

WIDTH, HEIGHT = 160, 120
SCENE = (planes.Plane(1, 4.0, "all", 0.0, highlights=0.01), planes.Plane(2, 4.0, "discs", 1.0, highlights=0.01))


@cache
def looked_at(radius: float, focus: float, points: int = 256) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(pinhole, photograph) in linear light, and the signed radius; made once a session, so nobody may write to them.

    At the size that planes have while the fixture `small` is in use.
    """
    pinhole, signed = planes.seen(SCENE, radius, focus, np.zeros((1, 2)))
    photograph = planes.seen(SCENE, radius, focus, lens_points(points))[0].sum(0) / points
    assert photograph.shape[:2] == (HEIGHT, WIDTH)
    found = pinhole.sum(0), photograph, signed
    for array in found:
        array.setflags(write=False)
    return found
