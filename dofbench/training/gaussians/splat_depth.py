"""Depth from our own Gaussian reconstruction of the all-in-focus images.

This depth is consistent between views, which monocular estimates aren't. All views train it, test views too:
the depth is part of the dataset's truth, not of any method.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.scenes.depth.source import DepthEstimate, SourceId, trust
from dofbench.scenes.scene import Scene, SceneView
from dofbench.training import gaussians


class SplatDepth:
    """Depth rendered from a trained reconstruction; 0 where it has no surface."""

    id: SourceId = "splat"
    confidence = (
        "accumulated opacity, times 1 / (1 + (s / 5 % of the view's disparity range)^2), s the standard deviation of "
        "disparity among the Gaussians that the pixel is blended from"
    )

    def __init__(self, reconstruction: gaussians.Reconstruction, provenance: dict[str, Any]):
        self._reconstruction, self._provenance = reconstruction, provenance

    @classmethod
    def make(
        cls, scene: Scene, *, steps: int, seed: int, work: Path, progress: Callable[[int, int], None] | None = None
    ) -> SplatDepth:
        """Reconstruct the scene, or load the reconstruction that an earlier run left in `work`.

        Raises InputError when the scene has no points to start from.
        """
        path = work / "reconstruction.npz"
        if not path.is_file():
            reconstruction = gaussians.reconstruct(scene, steps=steps, seed=seed, progress=progress)
            reconstruction.save(path)
        # Always from the file, so that a resumed run renders the same numbers as an uninterrupted one.
        reconstruction = gaussians.Reconstruction.load(path, steps=steps)
        provenance = {
            "from": "a Gaussian reconstruction of the all-in-focus images of all views",
            "steps": steps,
            "seed": seed,
            "options": dict(reconstruction.settings()),
        }
        return cls(reconstruction, provenance)

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth at the view's camera, 0 where nothing was reconstructed."""
        surface = self._reconstruction.surface(view.camera)
        known = surface.depth > 0
        confidence = np.where(known, np.clip(surface.alpha, 0, 1), 0)
        if known.any():
            low, high = np.percentile(1 / surface.depth[known], [5, 95])
            if high > low:
                confidence = confidence * trust(surface.spread / (high - low))
        return DepthEstimate(np.ascontiguousarray(surface.depth, dtype=np.float32), confidence.astype(np.float32))

    def provenance(self) -> dict[str, Any]:
        """Steps, seed and options of the training."""
        return self._provenance
