"""PDRF (Peng and Chellappa, AAAI 2023): its kernel in two stages on the shared field."""

from __future__ import annotations

from dofbench.training.fields.kernel_field_method import ProgressiveField


class PDRF(ProgressiveField):
    """See `ProgressiveField`; presets are in method.toml."""
