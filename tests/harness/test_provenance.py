"""Code version, machine, memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dofbench.evaluation.results import provenance
from dofbench.evaluation.scoring.error_maps import FULL_SCALE, error_map


def test_no_checkout_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_PACKAGE", tmp_path / "dofbench")
    assert provenance.git_state() is None
    (tmp_path / ".git").mkdir()  # not a repository that git knows
    assert provenance.git_state() is None


PEAK = """
import numpy as np
from dofbench.evaluation.results import provenance
provenance.reset_peak_memory()
before = provenance.peak_memory_mb()
block = np.ones(40_000_000, dtype=np.uint8)
print(provenance.peak_memory_mb() - before)
"""


def test_the_peak_is_the_run_s_own_where_the_system_can_tell() -> None:
    """In a process of its own, which keeps no memory that others freed."""
    done = subprocess.run([sys.executable, "-c", PEAK], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 30


def test_machine_and_packages() -> None:
    machine = provenance.machine("cpu")
    assert machine["cores"] >= 1 and machine["memory_gib"] > 0 and machine["device"] == "cpu"
    assert {"dofbench", "numpy", "torch"} <= set(provenance.package_versions())


def test_error_map_is_black_where_nothing_is_wrong_and_brightest_at_full_scale() -> None:
    truth = np.zeros((2, 3, 3), dtype=np.float32)
    prediction = truth.copy()
    prediction[0, 1], prediction[0, 2], prediction[1, 0] = FULL_SCALE / 2, FULL_SCALE, 1.0
    shown = error_map(prediction, truth).astype(int).sum(axis=2)
    assert shown[1, 1] < 10 < shown[0, 1] < shown[0, 2] == shown[1, 0]
    with pytest.raises(ValueError, match="one shape"):
        error_map(prediction, truth[1:])
