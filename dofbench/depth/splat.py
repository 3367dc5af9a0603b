"""Depth from our own Gaussian reconstruction of the all-in-focus images.

It is consistent between views, as no monocular estimate is. All views train it, test views too:
the depth is part of the dataset's truth, not of any method.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dofbench import gaussians
from dofbench.depth import SourceId
from dofbench.scenes.types import Scene, SceneView


class SplatDepth:
    """Depth rendered from a trained reconstruction; 0 where it has no surface."""

    id: SourceId = "splat"

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
            "steps": steps, "seed": seed, "options": dict(reconstruction.settings()),
        }
        return cls(reconstruction, provenance)

    def depth(self, view: SceneView) -> np.ndarray:
        """(H, W) float32 z-depth at the view's camera, scene units, 0 where nothing was reconstructed."""
        return np.ascontiguousarray(self._reconstruction.depth(view.camera), dtype=np.float32)

    def provenance(self) -> dict[str, Any]:
        """Steps, seed and options of the training."""
        return self._provenance
