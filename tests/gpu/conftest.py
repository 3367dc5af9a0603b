"""Setup for the tests of the GPU backends: Triton's interpreter runs their kernels on CPU tensors."""

from __future__ import annotations

from importlib.util import find_spec

import pytest


@pytest.fixture(autouse=True)
def _interpreted_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are interpreted if the variable is set when their module is first imported, which is by the first call:
    no test file calls one on import."""
    if find_spec("triton") is None:
        pytest.skip("no package triton, whose interpreter runs the GPU's kernels: pip install dofbench[gpu]")
    monkeypatch.setenv("TRITON_INTERPRET", "1")
