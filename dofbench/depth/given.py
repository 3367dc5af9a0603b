"""The depth that the scene itself comes with: rendered, scanned, or made by another program."""

from __future__ import annotations

from typing import Any

import numpy as np

from dofbench.depth import SourceId
from dofbench.errors import InputError
from dofbench.scenes.types import Scene, SceneView


def require_depth(scene: Scene) -> None:
    """Raise InputError unless every view of the scene has depth."""
    missing = [view.name for view in scene.views if view.depth is None]
    if missing:
        raise InputError(
            scene.root, f"no depth for {len(missing)} of {len(scene.views)} views ({missing[0]} first)",
            "depth of every view for --depth given",
        )


class GivenDepth:
    """The scene's own depth maps. Raises InputError when a view has none."""

    id: SourceId = "given"

    def __init__(self, scene: Scene):
        require_depth(scene)

    def depth(self, view: SceneView) -> np.ndarray:
        """(H, W) float32 z-depth, scene units, 0 where unknown. Raises InputError for a map that can't be one."""
        assert view.depth is not None
        depth = view.depth()
        subject = f"depth of {view.source}"
        size = (view.camera.height, view.camera.width)
        if depth.shape != size:
            raise InputError(subject, f"shape {depth.shape}", f"{size}, as its image")
        if np.isnan(depth).any() or (depth < 0).any():
            raise InputError(subject, "NaN or negative values", "z-depth, 0 where unknown")
        return depth.astype(np.float32, copy=False)

    def provenance(self) -> dict[str, Any]:
        """Nothing to say but where it is from."""
        return {"from": "the scene's own depth maps"}
