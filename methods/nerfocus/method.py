"""NeRFocus (Wang et al., 2022) on the shared field: trained as if photographs were sharp, rendered through a lens."""

from __future__ import annotations

from dofbench.training.fields.lens_field_method import RefocusedField


class NeRFocus(RefocusedField):
    """See `RefocusedField`; presets are in method.toml."""
