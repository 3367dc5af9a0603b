"""Dense depth by edge-aware completion of the sparse points' disparity."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from dofbench.core.errors import InputError
from dofbench.scenes.depth.completion import complete
from dofbench.scenes.depth.sightings import CLIPPED, Sightings, scene_sightings
from dofbench.scenes.depth.source import DepthEstimate, SourceId, clipped, trust
from dofbench.scenes.scene import Scene, SceneView

_REACH = 0.05  # share of the image width at which a point's weight is halved, and over which points are compared


class SfmDepth:
    """Completed depth. Raises InputError for a scene without points, or a view that saw none."""

    id: SourceId = "sfm"
    confidence = (
        "1 / (1 + (distance to the nearest trusted point / 5 % of the width)^2), times how well the points around "
        "agree with the surface and how level that is: 1/2 each for 5 % of the scene's disparity range"
    )

    def __init__(self, scene: Scene):
        self._sightings = scene_sightings(scene, "--depth sfm")
        self._tracks = scene.points is not None and scene.points.views is not None
        blind = [view.name for view in scene.views if len(self._sightings.by_view[view.name]) == 0]
        if blind:
            found = f"no sparse point that view {blind[0]} saw" + (f", nor {len(blind) - 1} more" if blind[1:] else "")
            raise InputError(scene.root, found, "some in every view for --depth sfm")

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth everywhere, from the points that the view saw."""
        sightings = self._sightings.by_view[view.name]
        completion = complete(view.image(), sightings, self._sightings.extent)
        disparity, outside = clipped(completion.disparity, self._sightings.floor, self._sightings.ceiling)
        trusted = completion.trusted > 0.5
        relative = np.abs(completion.residual) / self._sightings.extent
        confidence = _support(sightings, trusted, disparity.shape)
        confidence *= trust(spread_around(sightings, relative, disparity.shape))
        confidence *= trust(_unevenness(disparity) / self._sightings.extent)
        return DepthEstimate(
            (1 / disparity).astype(np.float32),
            confidence.astype(np.float32),
            {
                "points": len(sightings),
                "rejected": sightings.rejected,
                "doubted": int((~trusted).sum()),
                "median_residual": float(np.median(relative)),
                "clipped": outside,
            },
        )

    def provenance(self) -> dict[str, Any]:
        """What the numbers of each view mean."""
        return {
            "from": "sparse points, completed along the edges of the image (dofbench/scenes/depth/completion.py)",
            "seen": "by the points' tracks" if self._tracks else "without tracks: not behind the points around",
            "points": "of the view, outliers left out; rejected: those; doubted: of the points, by the completion",
            "median_residual": "of the points against the surface, as a share of the range of the points' disparities",
            "clipped": CLIPPED,
        }


def spread_around(sightings: Sightings, values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(H, W): root mean square of the sightings' values (M,) in a Gaussian of 5 % of the width; far away, of all."""
    height, width = size
    columns = min(width, 256)
    rows = max(1, round(height * columns / width))
    x = np.clip(sightings.xy[:, 0] * columns / width, 0, columns - 1).astype(int)
    y = np.clip(sightings.xy[:, 1] * rows / height, 0, rows - 1).astype(int)
    total: np.ndarray = np.zeros((rows, columns))
    count: np.ndarray = np.zeros((rows, columns))
    np.add.at(total, (y, x), values**2)
    np.add.at(count, (y, x), 1.0)
    # The mean of all points, with a thousandth of one point's weight, fills places that no point reaches.
    everywhere = 1e-3 / (columns * rows)
    sigma = _REACH * columns
    total = cv2.GaussianBlur(total, (0, 0), sigma) + everywhere * float(np.mean(values**2))
    count = cv2.GaussianBlur(count, (0, 0), sigma) + everywhere
    return cv2.resize(np.sqrt(total / count), (width, height), interpolation=cv2.INTER_LINEAR)


def _support(sightings: Sightings, trusted: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(H, W), 0 ... 1: nearness to a sighting that the completion trusts."""
    height, width = size
    away = np.ones(size, dtype=np.uint8)
    xy = sightings.xy[trusted].astype(int)
    away[np.minimum(xy[:, 1], height - 1), np.minimum(xy[:, 0], width - 1)] = 0
    if away.all():
        return np.zeros(size)
    distance = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return trust(distance, _REACH * width)


def _unevenness(disparity: np.ndarray) -> np.ndarray:
    """(H, W): standard deviation of the disparity within 1 % of the width: a break may be elsewhere."""
    side = 2 * round(0.01 * disparity.shape[1]) + 1
    offset = disparity - disparity.mean()
    mean, square = (cv2.blur(values, (side, side)) for values in (offset, offset**2))
    return np.sqrt(np.maximum(square - mean**2, 0.0))
