"""Robust Gaussian Splatting's model of defocus (Darmon et al., 2024): one learned blur for each photograph."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import UniformlyBlurred


class RobustSplatting(UniformlyBlurred):
    """See `UniformlyBlurred`; presets are in method.toml."""
