"""A finished run of the fake method, shared by the tests of films and of the viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import fake_run

from dofbench.core.jobs import Outcome


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """A function that runs the fake method on the small dataset in `tmp_path`/data."""
    return fake_run(tmp_path, monkeypatch)
