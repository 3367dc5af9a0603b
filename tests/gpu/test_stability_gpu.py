"""The stiff and extreme cases in the GPU's kernels, interpreted: the quickest of them again, and what a row says."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.gpu import stability

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 40.0  # what the quickest cases may take together


@pytest.mark.slow
def test_the_quickest_cases_still_meet_their_bounds(tmp_path: Path) -> None:
    """In a process of its own: which devices there are is asked when the cases are imported."""
    published = list(csv.DictReader((ROOT / "reports" / "gpu" / "stability.csv").open(encoding="utf-8")))
    met = sorted((float(row["seconds"]), row["case"]) for row in published if row["outcome"] == "met")
    chosen, total = [], 0.0
    for seconds, case in met:
        total += seconds
        chosen += [case] if total < SECONDS else []
    words = [sys.executable, "-m", "benchmarks.gpu.stability", "--out", str(tmp_path), "--case", *chosen]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    made = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path})
    assert made.returncode == 0, made.stderr
    rows = list(csv.DictReader((tmp_path / "stability.csv").open(encoding="utf-8")))
    assert {row["case"] for row in rows if row["outcome"] == "met"} == set(chosen) and len(chosen) > 10


@pytest.mark.parametrize(
    ("error", "outcome"), [(1.0, "met"), (3.0, "not met"), (float("nan"), "not met"), (None, "failed"), (-1.0, "slow")]
)
def test_a_row_says_how_its_case_ended(error: float | None, outcome: str) -> None:
    def measure(setting: object) -> SimpleNamespace:
        if error is None:
            raise ValueError("no such\nkernel")
        if error < 0:
            time.sleep(30)
        return SimpleNamespace(met=error <= 2, error=error, bound=2.0, note="a note")

    case = SimpleNamespace(id="group/name", subject="tone", measure=measure)
    setting = SimpleNamespace(label="gpu-cuda", precision="float32")
    row = stability.measured(case, setting, 0.2 if outcome == "slow" else 20)
    assert row["outcome"].startswith("too slow" if outcome == "slow" else outcome)
    assert (row["case"], row["kernel"]) == ("group/name", "tone")
    assert row.get("note", "") == {"failed": "ValueError: no such kernel", "slow": ""}.get(outcome, "a note")
