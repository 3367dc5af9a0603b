"""The scripts in benchmarks/ are run by hand; here that each can be imported."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(".".join(file.relative_to(ROOT).with_suffix("").parts) for file in (ROOT / "benchmarks").rglob("*.py"))


@pytest.mark.parametrize("module", MODULES)
def test_every_script_can_be_imported(module: str) -> None:
    """A script that nobody has run since a module was renamed would be noticed months later."""
    assert importlib.import_module(module).__doc__
