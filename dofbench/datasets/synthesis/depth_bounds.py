"""Near and far bounds of a dataset's views."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import numpy as np

from dofbench.core.images import read_exr
from dofbench.datasets.format import layout
from dofbench.datasets.format.points_choice import Points
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.export import depth_bounds, view_bounds
from dofbench.scenes.scene import Scene
from dofbench.scenes.visibility import visible


def bounds_of_views(scene: Scene, root: Path, kind: Points, measured: Set[str], at_once: int) -> np.ndarray | None:
    """(N, 2) near and far of the scene's views, in its order; None if nothing is known of any.

    From a view's depth map in the dataset folder `root`, if it is one of `measured`, else from the points that it sees.
    kind: `--points`. Where the points were triangulated between the training photographs, a method must not be told
    more than these photographs say, so then all bounds are from the points, and a test view gets those of all views.
    at_once: views at a time.
    """
    sparse = scene.points if scene.points is not None and len(scene.points) else None

    def bounds(index: int) -> tuple[float, float]:
        view, known = scene.views[index], np.empty(0)
        if kind == "scene" and view.name in measured:
            depth_map = read_exr(layout.depth_path(root, view.name))
            known = depth_map[depth_map > 0]
        if not known.size and sparse is not None:
            known = visible(sparse, view.camera, index).depth
        return view_bounds(known)

    return depth_bounds(over_views(bounds, range(len(scene.views)), at_once))
