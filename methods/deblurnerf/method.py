"""Deblur-NeRF (Ma et al., CVPR 2022): its deformable sparse kernel on the shared field."""

from __future__ import annotations

from dofbench.training.fields.kernel_field_method import DeformableField


class DeblurNeRF(DeformableField):
    """See `DeformableField`; presets are in method.toml."""
