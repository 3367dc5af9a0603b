"""What Gaussian methods share: model, trainer, losses, density control."""

from __future__ import annotations


def __getattr__(name: str):
    # torch is loaded only when one of these is asked for.
    if name in ("Reconstruction", "reconstruct"):
        from dofbench.gaussians import scene_fit

        return getattr(scene_fit, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
