"""The built-in scene at a size at which the blur of its surfaces can be measured, through lenses that are known."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.content import content_folder
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.lens import DisparityRange, Lens
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import load_scene
from dofbench.training.common.depth import all_disparities

WIDTH, EVERY = 160, 2


@cache
def _views() -> tuple[tuple[str, Camera, np.ndarray, np.ndarray], ...]:
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH)
    return tuple(
        (view.name, view.camera, view.image().astype(np.float32), view.depth()) for view in scene.views[::EVERY]
    )


@cache
def points() -> PointCloud:
    scene = load_scene(content_folder("datasets") / "tabletop", width=WIDTH)
    assert scene.points is not None
    return scene.points.seen_by(range(0, len(scene.views), EVERY))


@cache
def bounds() -> DisparityRange:
    """Of the sparse points, as in a training."""
    return DisparityRange.of_disparity(all_disparities(points(), [camera for _, camera, _, _ in _views()]))


def count() -> int:
    return len(_views())


def depths() -> list[np.ndarray]:
    return [depth for _, _, _, depth in _views()]


def photographs(apertures: Sequence[float], foci: Sequence[float]) -> TrainingSet:
    """Taken in turn through these lenses, normalised; an aperture of 0 is sharp."""
    views = []
    for number, (name, camera, image, depth) in enumerate(_views()):
        aperture, focus = apertures[number % len(apertures)], foci[number % len(foci)]
        if aperture > 0:
            lens = Lens(aperture, focus).physical(bounds(), WIDTH)
            image = defocus_numpy(image, depth, lens)[0].clip(0, 1).astype(np.float32)
        views.append(TrainingView(name, camera, image))
    return TrainingSet(tuple(views), points())
