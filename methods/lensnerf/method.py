"""LensNeRF (Kim et al., WACV 2024): rays from points of a lens on the shared field."""

from __future__ import annotations

from dofbench.training.fields.lens_field_method import LensRayField


class LensNeRF(LensRayField):
    """See `LensRayField`; presets are in method.toml."""
