"""Where a dataset's depth comes from: one source a file, all giving z-depth maps of the scene's views."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from dofbench.scenes.types import Scene, SceneView

SourceId = Literal["given", "folder", "splat"]


class DepthSource(Protocol):
    """Depth of a scene's views."""

    id: SourceId

    def depth(self, view: SceneView) -> np.ndarray:
        """(H, W) float32 z-depth at the view's camera, scene units, 0 where unknown."""

    def provenance(self) -> dict[str, Any]:
        """How the depth was made, as plain data for a manifest."""


def resolve(choice: Literal["auto", "given", "folder", "splat"], scene: Scene) -> SourceId:
    """The source that `choice` means for the scene: "auto" is the given depth if every view has it, else splat.

    Raises InputError for "given" when a view has no depth.
    """
    if choice == "given":
        from dofbench.depth.given import require_depth

        require_depth(scene)
    if choice != "auto":
        return choice
    return "given" if all(view.depth is not None for view in scene.views) else "splat"


def open_source(
    source: SourceId, scene: Scene, *, steps: int, seed: int, work: Path,
    progress: Callable[[int, int], None] | None = None,
) -> DepthSource:
    """Make the source ready for all views of the scene.

    steps, seed: of the reconstruction behind "splat"; work: a folder that keeps it, so that it is
    made once; progress: called with (step, steps) while it is made. Raises InputError when the scene
    lacks what the source needs.
    """
    if source != "splat":
        from dofbench.depth.given import GivenDepth

        return GivenDepth(scene, source)
    from dofbench.depth.splat import SplatDepth

    return SplatDepth.make(scene, steps=steps, seed=seed, work=work, progress=progress)


__all__ = ["DepthSource", "SourceId", "open_source", "resolve"]
