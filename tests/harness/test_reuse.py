"""Which runs have the key of a finished result, which is then reused."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from harness_fakes import text_console
from small_dataset import write_dataset

from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.plan import make_plan


def test_a_finished_result_is_reused(call) -> None:
    first = call()
    before = (first.folder / "result.json").read_bytes()
    console, stream = text_console()
    again = call(console)
    assert again.reused and again.folder == first.folder
    assert "using the cached result" in stream.getvalue()
    assert (first.folder / "result.json").read_bytes() == before


@pytest.mark.parametrize(
    "change", [{"set": ("noise=0.2",)}, {"seed": 1}, {"budget": "9it"}, {"inputs": "all-in-focus"}]
)
def test_any_change_is_another_result(call, change: dict) -> None:
    first, other = call(), call(**change)
    assert not other.reused and other.folder != first.folder


def test_other_data_or_code_is_another_result(call, tmp_path: Path) -> None:
    first = call()
    write_dataset(tmp_path / "data", seed=2)
    second = call()
    code = tmp_path / "methods" / "fake" / "behaviour.py"
    code.write_text(code.read_text() + "\nCHANGED = 1\n")
    third = call()
    assert not second.reused and not third.reused
    assert len({first.folder, second.folder, third.folder}) == 3


def test_nothing_else_changes_the_key(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code, data, options and seed do (above, and `test_provenance`); where, when and on what it runs doesn't."""
    key = read_result(call().folder).key

    def again(data: Path = tmp_path / "data", **changes) -> str:
        settings = RunSpec(**{"method": "fake", "data": data, "out": tmp_path / "results", **changes})
        return make_plan(settings, data).spec.key

    assert again(out=tmp_path / "elsewhere") == again(rerun=True) == again(dry_run=True) == key
    # Options that equal their defaults don't change the key
    assert again(preset="quick") == again(budget="8it") == again(device="cpu") == key
    assert again(shutil.copytree(tmp_path / "data", tmp_path / "moved" / "deep")) == key
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "7")
    monkeypatch.chdir(tmp_path)
    assert again(Path("data")) == key
    shutil.move(tmp_path / "methods", tmp_path / "installed")
    monkeypatch.setenv("DOFBENCH_METHODS", str(tmp_path / "installed"))
    assert again() == key
    (tmp_path / "installed" / "fake" / "notes.md").write_text("no code")
    assert again() == key and again(seed=1) != key
