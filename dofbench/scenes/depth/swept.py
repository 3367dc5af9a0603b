"""Depth of a light field's views by a plane sweep over the views around each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dofbench.core.images import cropped
from dofbench.scenes.depth.source import DepthEstimate, SourceId
from dofbench.scenes.light_field.grid import Place
from dofbench.scenes.light_field.rig import Rig
from dofbench.scenes.light_field.sweep import CLEAR_MARGIN
from dofbench.scenes.scene import SceneView


class SweptDepth:
    """places: of the views on the grid, by name. width: of the grid's views, pixels, of which `margin` are cropped at
    each border."""

    id: SourceId = "sweep"
    confidence = (
        "by how much the best disparity of the sweep is better than distant ones, as a share of "
        f"{CLEAR_MARGIN:g} of encoded grey, 1 at most; where it is low, depth is interpolated up to the next edge of "
        "the image"
    )

    def __init__(self, rig: Rig, places: Mapping[str, Place], width: int, margin: int):
        self._rig, self._places, self._width, self._margin = rig, places, width, margin

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth everywhere but where the parallax would be beyond infinity."""
        found = self._rig.swept(self._places[view.name], self._width)
        depth = self._rig.depth(cropped(found.disparity, self._margin))
        return DepthEstimate(depth, cropped(found.confidence, self._margin))

    def provenance(self) -> dict[str, Any]:
        """What was compared."""
        return {"from": "a plane sweep over the views around each view, at the dataset's size"}
