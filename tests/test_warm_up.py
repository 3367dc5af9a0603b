"""`dofbench warm-up`: everything that a run needs is compiled afterwards, and what can't be is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from called import called, dofbench
from fake_method import METHOD_TOML, write_method

from dofbench.cli.app import main
from dofbench.evaluation.results.result import read_result


@pytest.fixture
def methods(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of methods: `good`, and `broken`, which crashes."""
    folder = tmp_path / "methods"
    write_method(folder, "good")
    write_method(
        folder, "broken", toml=METHOD_TOML.replace('budget = "8it"', 'budget = "8it"\ntrouble = "crash"\nat = 1')
    )
    monkeypatch.setenv("DOFBENCH_METHODS", str(folder))
    return folder


def test_it_says_where_the_kernels_are(methods: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up", "--method", "good"]) == 0
    said = capsys.readouterr().out
    place = Path(said.split(" MB, in ")[1].split(";")[0])
    assert place.is_dir() and list(place.rglob("*.nbc"))


def test_every_method_is_trained(methods: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up", "--method", "good,broken"]) == 1
    said = capsys.readouterr().err
    assert "broken: crashed" in said and "good:" not in said


def test_an_unknown_method_is_a_wrong_call(methods: Path) -> None:
    assert main(["warm-up", "--method", "good,unheard-of"]) == 2


@pytest.mark.slow
def test_a_run_compiles_nothing_after_it(tmp_path: Path) -> None:
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_NUM_THREADS": "2"}
    done = called(dofbench("warm-up"), **cache)
    assert done.returncode == 0 and str(tmp_path / "cache") in done.stdout, done.stderr
    files = {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*.nbc")}
    run = dofbench("run", "--method", "lensselect", "--budget", "2it", "--out", tmp_path / "out")
    done = called(["env", "-C", str(tmp_path), *run], **cache)
    assert done.returncode == 0, done.stderr
    (result,) = (tmp_path / "out").rglob("result.json")
    assert read_result(result.parent).kernels_compiled == 0
    assert called(dofbench("warm-up"), **cache).returncode == 0
    assert files == {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*.nbc")}
