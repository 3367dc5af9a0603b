"""The writers of a report compute nothing: they import the view model, but neither results nor statistics."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

WRITERS = ("markdown_writer", "markdown_report", "csv_writer", "html")
# Where runs are read, averaged, compared and ranked.
COMPUTING = (
    "dofbench.results",
    "dofbench.running",
    *(
        f"dofbench.reporting.{name}"
        for name in ("summary", "differences", "paired", "pairwise", "verdict", "boards", "reach", "pareto", "layouts")
    ),
)


def imported(file: Path) -> set[str]:
    """The modules that a file imports from."""
    tree = ast.parse(file.read_text())
    return {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_knows_only_what_it_is_given(repository: Path, writer: str) -> None:
    place = repository / "dofbench" / "reporting" / writer
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    assert files
    for file in files:
        wrong = {name for name in imported(file) if name.startswith(COMPUTING)}
        assert not wrong, f"{file.name} imports {', '.join(wrong)}: let what builds the view say it"
