"""Mip-Splatting (Yu et al., CVPR 2024) on the shared trainer: the paper's ablation row 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from dofbench.gaussians.gaussian_method import GaussianMethod


class MipSplatting(GaussianMethod):
    """The same trainer as DoF-Gaussian with the lens, and all that depends on it, left out."""

    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off"}
