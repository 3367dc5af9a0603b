"""Setup for the tests of the GPU backends: Triton's interpreter runs their kernels on CPU tensors."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

_REPLACED: set[str] = set()


@pytest.fixture(autouse=True)
def _needs_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    if find_spec("triton") is None:
        pytest.skip("no package triton, whose interpreter runs the GPU's kernels: pip install dofbench[gpu]")
    from triton.runtime import interpreter

    # Where one interpreted function calls another, Triton searches its whole language once more for what the
    # interpreter replaces, a quarter of these tests' time. Once for each module is enough, as Triton doesn't undo it.
    def called(self: Any, *arguments: Any, **options: Any) -> Any:
        if self.fn.__module__ not in _REPLACED:
            _REPLACED.add(self.fn.__module__)
            interpreter._patch_lang(self.fn)
        return self.rewrite()(*arguments, **options)

    monkeypatch.setattr(interpreter.InterpretedFunction, "__call__", called)
