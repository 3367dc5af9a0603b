"""Setup for the tests of the GPU backends: Triton's interpreter runs their kernels on CPU tensors."""

from __future__ import annotations

from importlib.util import find_spec

import pytest
from backends import REASON, _quick_interpreter

__all__ = ["_quick_interpreter"]


@pytest.fixture(autouse=True)
def _needs_triton() -> None:
    if find_spec("triton") is None:
        pytest.skip(REASON)
