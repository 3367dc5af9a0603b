"""Mip-Splatting (Yu et al., CVPR 2024) on the shared trainer: the paper's ablation row 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from dofbench.training.gaussians.gaussian_method import GaussianMethod


class MipSplatting(GaussianMethod):
    """The same trainer as DoF-Gaussian without the lens and everything that depends on it."""

    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off"}
