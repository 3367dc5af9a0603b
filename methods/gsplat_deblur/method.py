"""gsplat's defocus module (pull request 469) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import Masked


class MaskedDeblurring(Masked):
    """See `Masked`; presets are in method.toml."""
