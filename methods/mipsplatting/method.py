"""Mip-Splatting (Yu et al., CVPR 2024) on the shared trainer: row 1 of DoF-Gaussian's ablation."""

from __future__ import annotations

from dofbench.training.gaussians.gaussian_method import LenslessMethod


class MipSplatting(LenslessMethod):
    """The shared trainer without the lens and all that depends on it; both of Mip-Splatting's filters are on."""
