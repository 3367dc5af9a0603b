"""Deblurring 3D Gaussian Splatting (Lee et al., ECCV 2024) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import Enlarged


class Deblurring3DGS(Enlarged):
    """See `Enlarged`; presets are in method.toml."""
