"""Where a dataset's depth comes from: one source a file, all giving z-depth maps of the scene's views."""

from __future__ import annotations

from typing import Any, Literal, Protocol

from dofbench.depth.estimate import DepthEstimate
from dofbench.scenes.scene import Scene, SceneView

SourceId = Literal["given", "folder", "splat", "sfm", "onnx"]


class DepthSource(Protocol):
    """Depth of a scene's views. confidence: what its confidence maps mean, in words."""

    id: SourceId
    confidence: str

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth and confidence at the view's camera."""

    def provenance(self) -> dict[str, Any]:
        """How the depth was made, as plain data for a manifest."""


def resolve(choice: Literal["auto"] | SourceId, scene: Scene) -> SourceId:
    """The source that `choice` means for the scene: "auto" is the given depth if every view has it, else splat.

    Raises InputError for "given" when a view has no depth.
    """
    if choice == "given":
        from dofbench.depth.given import require_depth

        require_depth(scene)
    if choice != "auto":
        return choice
    return "given" if all(view.depth is not None for view in scene.views) else "splat"


__all__ = ["DepthEstimate", "DepthSource", "SourceId", "resolve"]
