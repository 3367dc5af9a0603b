"""What every source of depth is to its user."""

from __future__ import annotations

from typing import Any, Literal, Protocol

from dofbench.scenes.depth.estimate import DepthEstimate
from dofbench.scenes.scene import SceneView

SourceId = Literal["given", "folder", "splat", "sfm", "onnx"]


class DepthSource(Protocol):
    """Depth of a scene's views. confidence: what its confidence maps mean, in words."""

    id: SourceId
    confidence: str

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth and confidence at the view's camera."""

    def provenance(self) -> dict[str, Any]:
        """How the depth was made, as plain data for a manifest."""
