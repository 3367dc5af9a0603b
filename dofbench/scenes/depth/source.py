"""Interface of a depth source, the depth that it gives, and the functions that confidences are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from dofbench.scenes.scene import SceneView

# A confidence of one half: the disparity is off by a twentieth of the scene's range, a fifth of what separates
# focus 0.5 from focus 0.75.
HALF_TRUSTED = 0.05


@dataclass(frozen=True, eq=False)
class DepthEstimate:
    """Depth of one view: z-depth (H, W) float32, scene units, 0 where unknown; confidence (H, W) float32, 0 ... 1;
    statistics: numbers on how the depth was found."""

    depth: np.ndarray
    confidence: np.ndarray
    statistics: dict[str, float] = field(default_factory=dict)


def trust(error: np.ndarray, half: float = HALF_TRUSTED) -> np.ndarray:
    """Confidence of an expected error: 1 for none, 1/2 at `half`, falling as its square (a Cauchy weight)."""
    return 1.0 / (1.0 + (error / half) ** 2)


def clipped(disparity: np.ndarray, floor: float, ceiling: float) -> tuple[np.ndarray, float]:
    """Disparity (H, W) within its positive bounds, and the share of pixels that were clipped."""
    outside = (disparity < floor) | (disparity > ceiling)
    return np.clip(disparity, floor, ceiling), float(outside.mean())


SourceId = Literal["given", "folder", "splat", "sfm", "onnx", "sweep"]


class DepthSource(Protocol):
    """Depth of a scene's views. confidence: what its confidence maps mean, in words."""

    id: SourceId
    confidence: str

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth and confidence at the view's camera."""

    def provenance(self) -> dict[str, Any]:
        """How the depth was made, as plain data for a manifest."""
