"""DoF-Gaussian (Shen et al., CVPR 2025): Gaussian splatting through a learnable thin lens for every view."""

from __future__ import annotations

from dofbench.training.gaussians.gaussian_method import GaussianMethod


class DoFGaussian(GaussianMethod):
    """Equations 1 to 13 of the paper, implemented on the shared trainer; presets are in method.toml."""
