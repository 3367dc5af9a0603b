"""`dofbench warm-up`: every method is trained, and what can't be is said. What it compiles: test_wheel.py."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_method import METHOD_TOML, write_method

from dofbench.cli.app import main


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
