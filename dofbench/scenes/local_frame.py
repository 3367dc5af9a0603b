"""Local frame of scenes far from their origin, such as georeferenced models.

float32 has steps of half a metre in a UTM zone. Such a scene is moved near the origin in float64 when it is read, and
back when its coordinates are written for other programs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import NO_OFFSET, Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.scenes.scene import Scene

# Distance of the origin, as a multiple of the scene's size, from which on a scene is moved. float32 rounds a distance
# of 100 sizes to 6e-6 of the size, less than a hundredth of a pixel of images 1000 pixels wide.
_FAR = 100.0
# As a multiple of the scene's size: a camera farther away than this isn't of the scene, and neither is a point, which
# no two cameras see under different angles.
_CAMERA_APART, _POINT_APART = 1e4, 1e5
# Points so many times as far from the cameras as they and the cameras are spread lie in another frame: all would fall
# within a milliradian.
_POINTS_ELSEWHERE = 1e3
# Share of the scene's size to which float32 may round what a file holds without being named.
_ROUNDED = 1e-4


class AnotherFrame(InputError):
    """Points, or the cameras of a model, that lie in another frame than the poses beside them."""


def localised(scene: Scene, offset: Offset | None, subject: object) -> Scene:
    """The scene in its local frame, with notes on what was done.

    offset: subtracted, without checks; None finds it (`local_offset`), excludes points far outside of the scene, and
    notes coordinates rounded to float32. Raises InputError about `subject` for a camera far outside of the scene, and
    AnotherFrame where all points are.
    """
    if offset is not None:
        return _moved(scene, offset)
    centres = np.stack([view.camera.centre for view in scene.views])
    centre, size = _layout(centres, scene.points)
    if not size > 0:
        return scene
    apart = _distances(centres, centre)
    if apart.max() > _CAMERA_APART * size:
        worst = int(np.argmax(apart))
        found = f"the camera of {scene.views[worst].name} {apart[worst]:.3g} scene units away from the others"
        raise InputError(subject, found, f"cameras of one scene, which is {size:.3g} scene units in size (median)")
    points, excluded = scene.points, ""
    if points is not None and len(points):
        _check_frame(points.xyz, centre, float(_median(apart)), subject)
        kept = _distances(points.xyz, centre) <= _POINT_APART * size
        if not kept.all():
            points = points.kept(kept)
            excluded = (
                f"{(~kept).sum()} of {len(kept)} points are more than {_POINT_APART:g} times as far away as others "
                "(median); excluded"
            )
    offset = local_offset(centres, scene.points)
    scene = replace(scene, points=points).noted(excluded)
    if offset == NO_OFFSET:
        return scene
    moved = (
        f"coordinates are far from the origin: ({', '.join(f'{value:.12g}' for value in offset)}) is subtracted, and "
        "added back in exported files"
    )
    named = [_rounded("camera positions", centres, size)]
    if points is not None:
        named.append(_rounded("points", points.xyz, size))
    return _moved(scene, offset).noted(moved, *named)


def local_offset(centres: np.ndarray, points: PointCloud | None) -> Offset:
    """The offset to subtract from a scene's coordinates; zero unless the origin is more than 100 scene sizes away.
    centres: (V, 3) of cameras.

    The size is the median distance of cameras (or of points, where larger) from the median camera. Its position is
    rounded to a power of two below the size, so that subtracting and adding it is exact to float64.
    """
    centre, size = _layout(centres, points)
    if not 0 < size < math.inf or not math.hypot(*centre) > _FAR * size:
        return NO_OFFSET
    unit = 2.0 ** math.floor(math.log2(size))
    x, y, z = (float(value) for value in np.round(centre / unit) * unit + 0.0)
    return x, y, z


def _layout(centres: np.ndarray, points: PointCloud | None) -> tuple[np.ndarray, float]:
    """(median centre (3,), the scene's size); medians, so that single outliers don't count."""
    centre = _median(centres)
    sizes = [_distances(places, centre) for places in (centres, *(() if points is None else (points.xyz,)))]
    return centre, max(float(_median(distances)) for distances in sizes if len(distances))


def _check_frame(xyz: np.ndarray, centre: np.ndarray, spread: float, subject: object) -> None:
    middle = _median(xyz)
    away = float(_distances(middle[None], centre)[0])
    extent = max(spread, float(_median(_distances(xyz, middle))))
    if len(xyz) > 1 and away > _POINTS_ELSEWHERE * extent:
        found = f"points {away:.3g} scene units away from the cameras, {extent:.3g} in extent (medians)"
        raise AnotherFrame(subject, found, "points and poses in one frame")


def _median(values: np.ndarray) -> np.ndarray:
    """The lower of two middle values, not their mean: of two frames with half of the cameras each, one is chosen."""
    return np.quantile(values, 0.5, axis=0, method="lower")


def _distances(places: np.ndarray, centre: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.linalg.norm(places - centre, axis=1)


def _moved(scene: Scene, offset: Offset) -> Scene:
    if offset == NO_OFFSET:
        return scene
    x, y, z = offset
    back = (-x, -y, -z)
    views = tuple(replace(view, camera=view.camera.moved(back)) for view in scene.views)
    points = None if scene.points is None else scene.points.moved(back)
    return replace(scene, views=views, points=points, offset=offset)


def _rounded(what: str, places: np.ndarray, size: float) -> str:
    """A note where positions (N, 3) look rounded to float32, whose steps there matter for a scene of this size."""
    with np.errstate(over="ignore"):
        stored = places.astype(np.float32)
    steps = np.abs(np.spacing(stored)).astype(np.float64)
    coarse = steps > _ROUNDED * size
    # Poses are inverted on the way here, which leaves the last bits of float64.
    if not coarse.any() or (np.abs(places - stored)[coarse] > 1e-3 * steps[coarse]).any():
        return ""
    return f"{what} are stored in steps of {steps[coarse].max():g} scene units, as float32 rounds them so far away"
