"""Depth that is there already: the scene's own, or maps in a folder; rendered, scanned, or another program's."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError
from dofbench.scenes.depth.source import DepthEstimate, SourceId
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.scene import Scene, SceneView

_SUFFIXES = (".exr", ".png", ".npy", ".bin", ".geometric.bin", ".photometric.bin")


def require_depth(scene: Scene) -> None:
    """Raise InputError unless every view of the scene has depth."""
    missing = [view.name for view in scene.views if view.depth is None]
    if missing:
        found = f"no depth for {len(missing)} of {len(scene.views)} views ({missing[0]} first)"
        raise InputError(scene.root, found, "depth of every view for --depth given")


def with_folder_depth(scene: Scene, folder: Path, unit: float) -> Scene:
    """The scene with z-depth from a folder of maps, of the views' size, times `unit`, in scene units.

    A map is named after its view or image file, with suffix .exr, .png, .npy, .bin, .geometric.bin or .photometric.bin.
    Raises InputError for a missing folder, and a view without a map or with several.
    """
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a folder of depth maps")
    views = []
    for view in scene.views:
        names = (f"{stem}{suffix}" for stem in dict.fromkeys((view.name, view.source.name)) for suffix in _SUFFIXES)
        maps = [folder / name for name in names if (folder / name).is_file()]
        if len(maps) != 1:
            found = " and ".join(path.name for path in maps) if maps else "no map"
            raise InputError(folder, f"{found} for view {view.name}", f"one, such as {view.name}.exr")
        views.append(replace(view, depth=partial(read_depth, maps[0], unit)))
    return replace(scene, views=tuple(views))


class GivenDepth:
    """The depth maps that the views have, their own or a folder's. Raises InputError when a view has none."""

    confidence = "1 where the depth is known: nothing is known of its error"

    def __init__(self, scene: Scene, source: SourceId = "given"):
        self.id: SourceId = source
        require_depth(scene)

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth, 0 where unknown, and confidence 1 where known. Raises InputError for a map that can't be one."""
        assert view.depth is not None
        depth = view.depth()
        subject = f"depth of {view.source}"
        size = (view.camera.height, view.camera.width)
        if depth.shape != size:
            raise InputError(subject, f"shape {depth.shape}", f"{size}, as its image")
        if np.isnan(depth).any() or (depth < 0).any():
            raise InputError(subject, "NaN or negative values", "z-depth, 0 where unknown")
        return DepthEstimate(depth.astype(np.float32, copy=False), (depth > 0).astype(np.float32))

    def provenance(self) -> dict[str, Any]:
        """Nothing to say but where it is from."""
        return {"from": "the scene's own depth maps" if self.id == "given" else "a folder of depth maps"}
