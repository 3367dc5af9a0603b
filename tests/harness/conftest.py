"""A fake method and a fake dataset, and a way to run the one on the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import fake_run

from dofbench.core.jobs import Outcome


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """`call(set=("noise=0.2",), …)` runs the fake method on the fake dataset, into tmp_path/results."""
    return fake_run(tmp_path, monkeypatch)
