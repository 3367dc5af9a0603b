"""3D Gaussian Splatting (Kerbl et al., SIGGRAPH 2023) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.vanilla import Vanilla


class Splatting(Vanilla):
    """See `Vanilla`; presets are in method.toml."""
