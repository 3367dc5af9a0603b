"""The type checker finds no error in anything that pyproject.toml names, with the settings in pyproject.toml."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dofbench.core.content import FOLDERS

pytestmark = pytest.mark.slow  # half a minute and more


@pytest.fixture
def checked(repository: Path, tmp_path: Path):
    """A function that runs the checker with more words; (status, output)."""

    def run(*words: str) -> tuple[int, str]:
        command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path), *words]
        done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    return run


def test_the_checker_finds_nothing(checked) -> None:
    status, said = checked()
    assert status == 0, said


def test_all_packages_and_content_are_checked(repository: Path) -> None:
    named = tomllib.loads((repository / "pyproject.toml").read_text())["tool"]["mypy"]["files"]
    assert set(named) == {"dofbench", *(folder for folder in FOLDERS if any((repository / folder).rglob("*.py")))}


def test_a_mistake_is_found(checked, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("from dofbench.core.lens import Lens\n\nLens('wide', 0.5)\n")
    status, said = checked(str(wrong))
    assert status == 1 and 'incompatible type "str"; expected "float"' in said


def test_a_function_that_says_no_types_is_found(checked, tmp_path: Path) -> None:
    untyped = tmp_path / "untyped.py"
    untyped.write_text("def half(number):\n    return number / 2\n")
    status, said = checked(str(untyped))
    assert status == 1 and "missing a type annotation" in said
