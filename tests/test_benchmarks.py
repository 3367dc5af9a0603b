"""The scripts in benchmarks/ are run by hand; here that each can be imported."""

from __future__ import annotations

import csv
import importlib
import sys
from pathlib import Path

import pytest
from small_dataset import write_dataset

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scripts import what lies beside them; depth_priors also a helper of the tests."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(sys, "argv", ["nothing"])
    for name in SCRIPTS:  # not one that an earlier test imported with something replaced
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_import_of_a_script_is_there(beside: None, script: str) -> None:
    """A script that nobody has run since a module was renamed would be noticed months later."""
    assert importlib.import_module(script).__doc__


def test_leaving_out_compares_the_plan_with_all_stages(beside: None, tmp_path: Path) -> None:
    leaving_out = importlib.import_module("leaving_out")
    data = write_dataset(tmp_path / "data")
    settings = leaving_out.Settings(
        (data,), tmp_path / "out", results=tmp_path / "results", preset="smoke", budget="2it", seeds=2
    )
    leaving_out.main(settings)
    with (tmp_path / "out" / "leaving-out.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert rows and {(row["forced"], row["seed"]) for row in rows} == {
        (forced, seed) for forced in ("True", "False") for seed in "01"
    }
    assert all(float(row["train_cpu_s"]) > 0 and float(row["aif_psnr"]) > 0 for row in rows)
    table = (tmp_path / "out" / "leaving-out.md").read_text().splitlines()
    assert len(table) == 4 and len({line.count("|") for line in table}) == 1
