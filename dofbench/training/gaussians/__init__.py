"""What Gaussian methods share: model, trainer, losses, density control."""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    # These names load torch, so they are imported only when they are used.
    if name in ("Reconstruction", "reconstruct"):
        from dofbench.training.gaussians import scene_fit

        return getattr(scene_fit, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
