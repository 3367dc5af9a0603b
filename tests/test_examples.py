"""The examples run, in order, at toy size; they are short, and use the public list alone."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import dofbench

FOLDER = Path(__file__).resolve().parents[1] / "examples"
FILES = sorted(FOLDER.glob("*.py"))
LONGEST = 40  # lines
ALLOWED = sys.stdlib_module_names | {"dofbench", "numpy"}


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


def test_they_are_numbered_in_order() -> None:
    assert [file.name[:3] for file in FILES] == [f"{number:02}_" for number in range(1, len(FILES) + 1)]
    listed = (FOLDER / "README.md").read_text()
    assert all(f"]({file.name})" in listed for file in FILES)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_it_is_short_and_uses_the_public_list_alone(file: Path) -> None:
    text = file.read_text()
    assert len(text.splitlines()) < LONGEST
    tree = ast.parse(text)
    assert f"python examples/{file.name}" in ast.get_docstring(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module]
        else:
            continue
        assert "dofbench" in names or not any(name.split(".")[0] == "dofbench" for name in names), "a module below"
        assert {name.split(".")[0] for name in names} <= ALLOWED
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "dofbench"
    }
    assert used and used <= set(dofbench.__all__)


def test_make_dataset(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("01_make_dataset.py")(place / "data", width=64)  # again: it is complete
    assert "is a valid dataset" in capsys.readouterr().out


def test_read_dataset(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("02_read_dataset.py")(place / "data")
    printed = capsys.readouterr().out
    assert "17 photographs of 64x48 pixels" in printed and printed.count("scene units") == 3


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


def test_read_results(results: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("05_read_results.py")(results, place / "report")
    assert "tabletop, dofgaussian cpu, seed 0: ok, psnr" in capsys.readouterr().out
    assert (place / "report" / "report.html").is_file()


def test_score_pictures(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main_of("06_score_pictures.py")(place / "data", place / "data" / "all_in_focus")
    assert capsys.readouterr().out.count("PSNR inf") == 3
