"""A radiance field that takes every photograph for sharp: the plain version of the other fields."""

from __future__ import annotations

from dofbench.training.fields.field_method import FieldMethod


class PlainField(FieldMethod):
    """See `FieldMethod`; presets are in method.toml."""
