"""Stiff and extreme cases for every kernel, the image code and the methods; each states a property and an error
bound."""

from __future__ import annotations

from typing import Any

__all__ = ["stability"]


def __getattr__(name: str) -> Any:
    # This name loads torch, so it is imported only when it is used.
    if name in __all__:
        from dofbench.evaluation.stability import measure

        return getattr(measure, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
