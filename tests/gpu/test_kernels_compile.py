"""Training's kernels compile for a GPU that isn't here, spill nothing, and reach the listed occupancy.

One architecture, the GPU of the published measurements: three take nine minutes. `python -m benchmarks.gpu.kernels`
compiles for all of them.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dofbench.runtime.ops import backends, ops

ROOT = Path(__file__).resolve().parents[2]


ARCHITECTURE = "90"


@pytest.mark.slow
def test_all_kernels_compile_ahead_of_time(tmp_path: Path) -> None:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "TRITON_INTERPRET": "0"}  # compiled, as on a GPU
    made = subprocess.run(
        [sys.executable, "-m", "benchmarks.gpu.kernels", "--out", str(tmp_path), "--architectures", ARCHITECTURE],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert made.returncode == 0, made.stderr  # names what spills, or is below half occupancy without a reason
    rows = list(csv.DictReader((tmp_path / "kernels.csv").open(encoding="utf-8")))
    assert {row["op"] for row in rows} == {op for op in ops() if "gpu" in backends(op)}
    assert {row["spilled"] for row in rows} == {"0"}
    published = list(csv.DictReader((ROOT / "reports" / "gpu" / "kernels.csv").open(encoding="utf-8")))
    published = [row for row in published if row["architecture"] == ARCHITECTURE]
    key = ("op", "kernel", "constants", "architecture")
    assert {tuple(row[name] for name in key) for row in rows} == {tuple(row[name] for name in key) for row in published}
