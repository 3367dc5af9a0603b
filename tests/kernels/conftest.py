"""Setup for the tests of kernels."""

from __future__ import annotations

from backends import _quick_interpreter

__all__ = ["_quick_interpreter"]
