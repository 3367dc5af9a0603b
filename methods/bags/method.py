"""BAGS (Peng et al., ECCV 2024) on the shared trainer."""

from __future__ import annotations

from dofbench.training.gaussians.blur_methods import Proposed


class BAGS(Proposed):
    """See `Proposed`; presets are in method.toml."""
