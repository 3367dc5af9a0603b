"""DP-NeRF (Lee et al., CVPR 2023): rigid motions of rays and proposed weights on the shared field."""

from __future__ import annotations

from dofbench.training.fields.kernel_field_method import RigidField


class DPNeRF(RigidField):
    """See `RigidField`; presets are in method.toml."""
