"""Results of several methods, seeds, scenes and inputs, and the report of them, made once."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fake_method import fake_run
from harness_fakes import Here
from relisted import edit_json
from rich.console import Console
from small_dataset import write_dataset

from dofbench.cli.ablate import make_tables
from dofbench.core.errors import InputError
from dofbench.core.images import write_png
from dofbench.reporting import report_files
from dofbench.reporting.report_files import Written, write_report
from dofbench.reporting.report_options import Report
from dofbench.running.ablation_options import Ablate
from dofbench.viewing.film import write_video

TABLES = """\
method = "fake"

[[tables]]
id = "noise"
title = "What noise costs"
note = "More of it is worse."
columns = ["psnr", "aif_psnr", "delta_a"]
switches = ["noisy"]
reference = "some"
source = "Nobody 2020, Table 9"
paper_data = "on their own waves"

[[tables.rows]]
label = "some"
switches = { noisy = false }
paper = { aif_psnr = 21.5 }

[[tables.rows]]
label = "more"
switches = { noisy = true }
set = { noise = 0.8 }

[[tables.rows]]
label = "pinhole"
method = "pinhole"
switches = { noisy = false }
"""


@dataclass(frozen=True)
class Made:
    """results: their folder. out: the report's. ablation: a folder of tables, shown in it. said: while it was made."""

    results: Path
    out: Path
    ablation: Path
    said: str

    @property
    def pages(self) -> dict[str, str]:
        """Name -> HTML of every page."""
        return {file.stem: file.read_text() for file in sorted(self.out.glob("*.html"))}

    @property
    def page(self) -> str:
        """The first page as text."""
        return self.pages["report"]


def set_times(file: Path) -> None:
    """Half a second a step, and a tenth more for each seed: what these runs really took is chance."""

    def set_pace(data: dict) -> None:
        pace = 0.5 * (1 + 0.1 * data["spec"]["seed"])
        for point in data["curve"]:
            point["train_s"] = pace * point["steps"]
        data["scores"]["train_s"] = pace * data["scores"]["steps"]

    edit_json(file, set_pace)


def write_film(folder: Path) -> None:
    """A film of two frames, as `dofbench render` writes it, where it can be written."""
    frames = [folder / "frames" / f"{index}.png" for index in (1, 2)]
    for index, frame in enumerate(frames):
        write_png(frame, np.full((48, 64, 3), index / 2, np.float32))
    with suppress(InputError):  # without PyAV
        write_video(frames, folder / "film.mp4")


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
        write_film(call(inputs="all-in-focus").folder / "film")
        ablation = folder / "ablation"
        (folder / "tables.toml").write_text(TABLES)
        waves = write_dataset(folder / "many", test=7)
        asked = Ablate(data=str(waves), tables=folder / "tables.toml", seeds=2, results=folder / "rows", out=ablation)
        assert make_tables(asked, Console(quiet=True), Here())
        # Figures take most of the time, and aren't in the page.
        monkeypatch.setattr(report_files, "write_curves", lambda *_: {})
        monkeypatch.setattr(report_files, "write_strip", lambda *_: "these tests want none")
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
    monkeypatch.setattr(report_files, "write_curves", lambda *_: {})
    monkeypatch.setattr(report_files, "write_strip", lambda *_: "this test wants none")


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., tuple[Written, Path, str]]:
    """`made()` writes the report of tmp_path/results; returns what was written, where, and what was said."""

    def made(out: str = "board", pictures: bool = True, reach: str = "") -> tuple[Written, Path, str]:
        stream = io.StringIO()
        settings = Report(tmp_path / "results", tmp_path / out, pictures, reach)
        written = write_report(settings, Console(file=stream, width=400))
        return written, tmp_path / out, stream.getvalue()

    return made
