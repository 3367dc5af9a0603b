"""The variant is tried in another process, and missing parts are reported in one line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.scenes.procedural.variant import SCALAR, VECTORISED, choose_variant


@pytest.fixture
def restored(variant):
    """The session's variant is chosen again afterwards."""
    import mitsuba as mi

    yield
    mi.set_variant(variant)


def test_a_library_that_aborts_the_process_is_survived(restored, monkeypatch):
    """Debian's LLVM 15 loads, then aborts at the first render."""
    old = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")
    if not old.is_file():
        pytest.skip(f"no {old.name} here")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(old))
    assert choose_variant()[0] == SCALAR


def test_the_scalar_variant_by_name_or_for_want_of_a_library(restored, monkeypatch, tmp_path):
    assert choose_variant(SCALAR) == (SCALAR, "")
    with pytest.raises(InputError, match="auto or one of"):
        choose_variant("fast")
    library = tmp_path / "libLLVM-99.so"
    library.write_text("no library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    chosen, remark = choose_variant()
    assert chosen == SCALAR
    assert str(library) in remark and "slower" in remark
    with pytest.raises(InputError, match="libLLVM"):
        choose_variant(VECTORISED)


def test_without_mitsuba_it_is_one_line(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    assert app.main(["make-scene", "fence", "--out", str(tmp_path / "fence")]) == 2
    assert "pip install 'dofbench[render]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
