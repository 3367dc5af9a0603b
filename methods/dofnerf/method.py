"""DoF-NeRF (Wu et al., ACM MM 2022): scattered patches on the shared field."""

from __future__ import annotations

from dofbench.training.fields.lens_field_method import PatchField


class DoFNeRF(PatchField):
    """See `PatchField`; presets are in method.toml."""
