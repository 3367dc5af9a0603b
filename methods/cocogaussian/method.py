"""CoCoGaussian (Lee et al., CVPR 2025) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import Copied


class CoCoGaussian(Copied):
    """See `Copied`; presets are in method.toml."""
