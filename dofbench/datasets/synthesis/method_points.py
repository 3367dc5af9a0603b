"""The points that a method gets: the scene's, or triangulated between the dataset's own training photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.core.masks import read_mask
from dofbench.core.progress import Progress
from dofbench.datasets.format import layout
from dofbench.datasets.format.points_choice import Points
from dofbench.datasets.format.points_record import NOT_STATED, FoundIn, FoundInViews, Origin, PointsRecord, Poses
from dofbench.scenes.light_field.grid import LIGHT_FIELD
from dofbench.scenes.procedural.scene_folder import RECORD
from dofbench.scenes.reconstruction.photograph_list import Photograph
from dofbench.scenes.reconstruction.posed_points import program, triangulated_points
from dofbench.scenes.scene import Scene

# Fewer say too little of where surfaces are to start from: ten a view for ten views. COLMAP itself takes no pose from
# fewer than 30 points in a view.
LEAST_POINTS = 100
_PLACES = {"sharp": layout.sharp_path, "shallow": layout.shallow_path}


def triangulated_between(
    root: Path,
    kind: Points,
    views: Sequence[tuple[str, Camera]],
    work: Path,
    progress: Progress,
    *,
    narrow: bool = False,
) -> PointCloud | None:
    """Points triangulated between the pictures that the dataset folder `root` has of these views, of one kind: "sharp"
    or "shallow". Tracks index into `views`, (name, camera) each. work: a folder for everything in between. None without
    any point. narrow: whether the cameras are close together, as on a light field's grid.

    Reads the pictures of these views and nothing else, so that they alone decide the points.
    """
    place: Callable[[Path, str], Path] = _PLACES[kind]
    photographs = [
        Photograph(
            name,
            place(root, name),
            partial(read_image, place(root, name)),
            camera=camera,
            mask=partial(read_mask, mask) if (mask := layout.mask_path(root, name)).is_file() else None,
        )
        for name, camera in views
    ]
    # The seed is fixed, so that datasets that differ in the seed of their lenses differ in nothing else.
    return triangulated_points(photographs, work, seed=0, progress=progress, narrow=narrow)


def choose_points(
    scene: Scene, kind: Points, root: Path, work: Path, progress: Progress
) -> tuple[PointCloud | None, PointsRecord]:
    """The points of the dataset in `root`, with tracks over the scene's views, and the record of where they come from.

    kind: `--points`. The dataset's photographs must be there already. Raises InputError where too few points are
    triangulated.
    """
    training = [index for index, view in enumerate(scene.views) if view.split == "train"]
    points = scene.points
    if kind != "scene":
        views = [(scene.views[index].name, scene.views[index].camera) for index in training]
        found = triangulated_between(root, kind, views, work, progress, narrow=scene.layout == LIGHT_FIELD)
        if found is None or len(found) < LEAST_POINTS:
            said = f"{0 if found is None else len(found)} points between {len(training)} training photographs"
            raise InputError(f"--points {kind}", said, f"at least {LEAST_POINTS}")
        assert found.views is not None
        order = np.array(training)
        points = PointCloud(found.xyz, found.rgb, found.error, tuple(order[track] for track in found.views))
    return points, _record(scene, kind, points, training)


def _record(scene: Scene, kind: Points, points: PointCloud | None, training: Sequence[int]) -> PointsRecord:
    tracked = points is not None and points.views is not None
    rendered = (scene.root / RECORD).is_file()
    known = rendered or _by_structure_from_motion(scene)
    origin: Origin = "rendered scene" if rendered else "structure from motion" if known else NOT_STATED
    photographs: FoundIn = _photographs(scene) if known else NOT_STATED
    views: FoundInViews = "all" if known else NOT_STATED
    if kind != "scene":
        origin, photographs, views = "triangulation", kind, "training"
    return PointsRecord(
        origin=origin if points is not None and len(points) else "none",
        photographs=photographs,
        views=views,
        poses=_poses(scene, rendered, known),
        tracks="known" if tracked else "unknown",
        only_test_views="left out" if tracked else "given",
        count=0 if points is None else len(points),
        given=0 if points is None else len(points.seen_by(training)),
        program="" if kind == "scene" else program(),
    )


def _poses(scene: Scene, rendered: bool, known: bool) -> Poses:
    if scene.layout == LIGHT_FIELD:
        return "grid of a light field"
    return "exact" if rendered else "structure from motion on all views" if known else NOT_STATED


def _by_structure_from_motion(scene: Scene) -> bool:
    """Whether the scene's layout is that of a structure from motion model, or such a model gave its points: a file of
    points without tracks doesn't say where they come from."""
    return scene.layout != "nerfstudio" or (scene.points is not None and scene.points.views is not None)


def _photographs(scene: Scene) -> FoundIn:
    """What the scene's photographs are, in which its points were found."""
    shallow = [view.photograph == "shallow" for view in scene.views]
    return "shallow" if all(shallow) else "shallow and sharp" if any(shallow) else "sharp"
