"""Results of several methods, seeds, scenes and inputs, and the report of them, made once."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from harness_fakes import fake_run, write_dataset
from rich.console import Console

from dofbench.reporting import board
from dofbench.reporting.board import Written, write_report
from dofbench.reporting.report_options import Report

SUMMARY = """\
table,row,dataset,seeds,column,mean,sd,status,paper,difference,difference_sd,p,pairs
table4,#1,waves,0 1,aif_psnr,20.5,0.25,ok,,,,,
table4,#2,waves,0 1,aif_psnr,22.75,0.5,ok,,,,,
table4,#1,waves,0 1,psnr,,,no such score,,,,,
table4,#2,waves,0 1,psnr,30.5,0.5,ok,,,,,
table4,#1,mean,0 1,aif_psnr,20.5,0.25,ok,21.31,-2.25,0.125,0.01,2
table4,#2,mean,0 1,aif_psnr,22.75,0.5,ok,23.05,,,,
table4,#1,mean,0 1,psnr,,,no such score,,,,,
table4,#2,mean,0 1,psnr,30.5,0.5,ok,,,,,
"""


@dataclass(frozen=True)
class Made:
    """results: their folder. out: the report's. ablation: a folder of tables, shown in it. said: while it was made."""

    results: Path
    out: Path
    ablation: Path
    said: str

    @property
    def page(self) -> str:
        """The report as text."""
        return (self.out / "report.html").read_text()


def set_times(file: Path) -> None:
    """Half a second a step, and a tenth more for each seed: what these runs really took is chance."""
    data = json.loads(file.read_text())
    pace = 0.5 * (1 + 0.1 * data["spec"]["seed"])
    for point in data["curve"]:
        point["train_s"] = pace * point["steps"]
    data["scores"]["train_s"] = pace * data["scores"]["steps"]
    file.write_text(json.dumps(data))


@pytest.fixture(scope="session")
def made_report(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Two scenes of which the paper has one, three seeds, a method without a lens, a failure, and sharp inputs."""
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as monkeypatch:
        call = fake_run(folder, monkeypatch)
        fern = write_dataset(folder / "fern", name="fern_small", seed=1, test=3)
        for seed in (0, 1, 2):
            call(seed=seed, set=("noise=0.4",))
            call(seed=seed)
        call(method="pinhole")
        call(set=("trouble=lost",))
        call(data=fern)
        call(data=fern, method="pinhole")
        call(inputs="all-in-focus")
        for file in sorted((folder / "results").rglob("result.json")):
            set_times(file)
        ablation = folder / "ablation"
        ablation.mkdir()
        (ablation / "table4-summary.csv").write_text(SUMMARY)
        (ablation / "table4.md").write_text("# What each component is worth\n")
        # Figures take most of the time, and aren't in the page.
        monkeypatch.setattr(board, "write_curves", lambda *_: {})
        monkeypatch.setattr(board, "write_strip", lambda *_: "these tests want none")
        stream = io.StringIO()
        settings = Report(folder / "results", folder / "out", ablation=ablation)
        assert write_report(settings, Console(file=stream, width=400))
    # The fakes are taken back here: this lasts as long as the session, and other tests want the real ones.
    return Made(folder / "results", folder / "out", ablation, stream.getvalue())


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    return fake_run(tmp_path, monkeypatch)


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures: they take most of the time, and most tests look at tables."""
    monkeypatch.setattr(board, "write_curves", lambda *_: {})
    monkeypatch.setattr(board, "write_strip", lambda *_: "this test wants none")


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., tuple[Written, Path, str]]:
    """`made()` writes the report of tmp_path/results; returns what was written, where, and what was said."""

    def made(out: str = "board", pictures: bool = True, reach: str = "") -> tuple[Written, Path, str]:
        stream = io.StringIO()
        settings = Report(tmp_path / "results", tmp_path / out, pictures, reach)
        written = write_report(settings, Console(file=stream, width=400))
        return written, tmp_path / out, stream.getvalue()

    return made
