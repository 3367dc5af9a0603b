"""Python files in the current folder are nobody's modules: no command and no process that it starts runs them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from called import called, dofbench, fake_method_and_data

from dofbench.scenes.procedural import variant

# Standard modules that multiprocessing, numpy, torch or this program import after the start.
NAMES = (
    "threading",
    "json",
    "random",
    "multiprocessing",
    "resource",
    "secrets",
    "statistics",
    "yaml",
    "numpy",
    "tomllib",
)


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with modules that leave a file if they run."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(
            f"open({str(folder / 'ran.txt')!r}, 'a').write({name!r} + '\\n')\nraise ImportError('the trap')\n"
        )
    monkeypatch.chdir(folder)
    return folder / "ran.txt"


def test_the_trap_works(trap: Path) -> None:
    called([sys.executable, "-c", "import random"])
    assert trap.read_text() == "random\n"


@pytest.mark.slow
def test_runs_and_datasets_in_processes_of_their_own(
    trap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_method_and_data(tmp_path, monkeypatch, width=32)
    checkout = str(Path(variant.__file__).parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.environ["PYTHONPATH"], checkout]))
    data, out = tmp_path / "data", tmp_path / "results"
    for words in (
        ("run", "--method", "fake", "--data", data, "--out", out, "--seeds", "2", "--jobs", "2"),
        ("check", out),
        ("make-dataset", "--width", "32", "--assign", "fixed", "--focus", "0.2,0.8", "--aperture", "1", "--jobs", "2",
         "--out", tmp_path / "made"),
    ):  # fmt: skip
        done = called(dofbench(*words))
        assert done.returncode == 0, done.stderr
        assert not trap.exists(), trap.read_text()


def test_the_trial_of_a_renderer(trap: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere")
    variant._find_llvm()
    assert not trap.exists()
