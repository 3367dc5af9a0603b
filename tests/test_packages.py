"""Packages import downwards only, functions' own imports included."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# From the ground up. methods/ is content, reached through the package of this name; kernels/ through runtime.ops.
ORDER = (
    "core",
    "runtime",
    "optics",
    "scenes",
    "training",
    "datasets",
    "methods",
    "evaluation",
    "running",
    "reporting",
    "viewing",
    "cli",
)
IMPORT = re.compile(r"^\s*(?:from|import) dofbench(?:\.| import )(\w+)", re.MULTILINE)


def upward(package: str, source: str) -> list[str]:
    """The packages that a source of `package` imports from above it."""
    return [name for name in IMPORT.findall(source) if name in ORDER and ORDER.index(name) > ORDER.index(package)]


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_down_only(package: str) -> None:
    content = {"runtime": ["kernels"], "methods": ["methods"]}.get(package, [])
    files = [file for place in (f"dofbench/{package}", *content) for file in (ROOT / place).rglob("*.py")]
    assert files
    assert {str(file): found for file in files if (found := upward(package, file.read_text()))} == {}


def test_an_import_that_runs_up_is_found() -> None:
    for text in ("from dofbench.cli import x", "import dofbench.cli.x", "    from dofbench import cli"):
        assert upward("core", text) == ["cli"] and upward("cli", text) == []
