"""DOF-GS (Wang et al., CVPR 2025) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import Focused


class DOFGS(Focused):
    """See `Focused`; presets are in method.toml."""
