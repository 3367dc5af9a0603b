"""The backends of kernels that tests run: the CPU's, and the GPU's by Triton's interpreter where it is installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

REASON = "no package triton, whose interpreter runs the GPU's kernels: pip install dofbench[gpu]"
GPU = pytest.param("gpu", marks=pytest.mark.skipif(find_spec("triton") is None, reason=REASON))
COMPILED = ["cpu", GPU]
_REPLACED: set[str] = set()

compiled = pytest.mark.parametrize("backend", COMPILED)
every = pytest.mark.parametrize("backend", [*COMPILED, "reference"])


@pytest.fixture(autouse=True)
def _quick_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one interpreted function calls another, Triton searches its whole language once more for what the
    interpreter replaces, a quarter of these tests' time. Once for each module is enough, as Triton doesn't undo it."""
    if find_spec("triton") is None:
        return
    from triton.runtime import interpreter

    def called(self: Any, *arguments: Any, **options: Any) -> Any:
        if self.fn.__module__ not in _REPLACED:
            _REPLACED.add(self.fn.__module__)
            interpreter._patch_lang(self.fn)
        return self.rewrite()(*arguments, **options)

    monkeypatch.setattr(interpreter.InterpretedFunction, "__call__", called)
