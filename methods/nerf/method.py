"""A radiance field that assumes all-in-focus inputs: the plain version of the other fields."""

from __future__ import annotations

from dofbench.training.fields.field_method import FieldMethod


class PlainField(FieldMethod):
    """A factorised grid (TensoRF; Chen et al., ECCV 2022), trained on one ray a pixel; its parts are in
    `dofbench/training/fields`."""
