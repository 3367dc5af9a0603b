"""Packages import downwards only, functions' own imports included."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# From the ground up. kernels/ and methods/ are content, reached through the packages of these names.
ORDER = (
    "core", "compute", "kernels", "optics", "metrics", "scenes", "depth", "dataset", "learning", "gaussians", "fields",
    "external", "methods", "results", "scoring", "running", "procedural", "synthesis", "reporting", "validation",
    "stability", "commands", "cli", "entry",
)  # fmt: skip
IMPORT = re.compile(r"^\s*(?:from|import) dofbench(?:\.| import )(\w+)", re.MULTILINE)


def upward(package: str, source: str) -> list[str]:
    """The packages that a source of `package` imports from, and that stand above it."""
    return [name for name in IMPORT.findall(source) if name in ORDER and ORDER.index(name) > ORDER.index(package)]


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_down_only(package: str) -> None:
    files = [file for place in (ROOT / "dofbench", ROOT) for file in (place / package).rglob("*.py")]
    files += [file for file in [ROOT / "dofbench" / f"{package}.py"] if file.is_file()]
    assert files
    assert {str(file): found for file in files if (found := upward(package, file.read_text()))} == {}


def test_an_import_that_runs_up_is_found() -> None:
    for text in ("from dofbench.cli import x", "import dofbench.cli.x", "    from dofbench import cli"):
        assert upward("core", text) == ["cli"] and upward("entry", text) == []
