"""Stiff and extreme cases for every kernel, the image code and the methods, each with what must hold and a bound."""

from __future__ import annotations

__all__ = ["stability"]


def __getattr__(name: str):
    # torch is loaded only when this is asked for.
    if name in __all__:
        from dofbench.stability import measure

        return getattr(measure, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
