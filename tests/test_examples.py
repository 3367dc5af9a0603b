"""The examples run, in order, at toy size."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest

import dofbench

FOLDER = Path(__file__).resolve().parents[1] / "examples"


def main_of(file: str) -> Callable[..., None]:
    """The function main of an example."""
    spec = importlib.util.spec_from_file_location("example", FOLDER / file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the first example has made its dataset, a small one."""
    folder = tmp_path_factory.mktemp("examples")
    main_of("01_make_dataset.py")(folder / "data", width=64)
    return folder


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    """Results of the example that trains, after a few steps."""
    main_of("04_train_and_score.py")(place / "data", place / "results", steps=6)
    return place / "results"


def test_make_dataset(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("01_make_dataset.py")(place / "data", width=64)  # again: it is complete
    assert "is a valid dataset" in capsys.readouterr().out


def test_read_dataset(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("02_read_dataset.py")(place / "data")
    printed = capsys.readouterr().out
    assert "17 training views of 64x48 pixels" in printed and printed.count("scene units") == 3


def test_blur_an_image(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("03_blur_an_image.py")(place / "data", place / "refocused.png")
    decibels = float(capsys.readouterr().out.split("blurred again: ")[1].split()[0])
    assert decibels > 55  # rounding to 8 bits alone leaves 58.9
    assert dofbench.read_image(place / "refocused.png").shape == (48, 64, 3)


def test_train_and_score(results: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("04_train_and_score.py")(place / "data", results, steps=6)
    printed = capsys.readouterr().out
    assert "ok after 6 steps" in printed and "  aif_psnr: " in printed
    assert "  delta_a: " in printed  # six steps show no trial all photographs, so the lens stays


@pytest.mark.slow
def test_read_results(results: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("05_read_results.py")(results, place / "report")
    assert "tabletop, dofgaussian short, seed 0: ok, psnr" in capsys.readouterr().out
    assert (place / "report" / "report.html").is_file()


def test_score_pictures(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("06_score_pictures.py")(place / "data", place / "data" / "all_in_focus")
    assert capsys.readouterr().out.count("PSNR inf") == 3


def test_paper_figure(results: Path, place: Path) -> None:
    (run,) = results.rglob("result.json")
    main_of("07_paper_figure.py")(run.parent, place / "figure.png")
    figure = dofbench.read_image(place / "figure.png")
    assert figure.shape[1] == 2100 and figure.std() > 0.1
