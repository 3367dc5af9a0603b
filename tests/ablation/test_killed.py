"""The command as a user calls it, in processes of its own, killed in the middle and called again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from harness_fakes import write_method

from dofbench.core.content import content_folder
from dofbench.synthesis import make_dataset
from dofbench.synthesis.dataset_options import MakeDataset

TABLES = """\
method = "fake"

[[tables]]
id = "pauses"
title = "Pauses"
columns = ["aif_psnr", "disparity_error"]
reference = "none"

[[tables.rows]]
label = "none"

[[tables.rows]]
label = "long"
set = { pause = 1.5 }

[[tables.rows]]
label = "killed"
set = { trouble = "killed" }
"""
LIMIT = 120  # seconds for a run to begin on a busy machine


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`dofbench ablate` on a small dataset, with a method that costs nothing, two runs at a time."""
    make_dataset(
        MakeDataset(scene=str(content_folder("datasets") / "thinlens" / "foliage"), width=64, out=tmp_path / "data")
    )
    methods = write_method(tmp_path / "methods")
    behaviour = methods / "fake" / "behaviour.py"
    behaviour.write_text(
        behaviour.read_text().replace(
            "    match options",
            '    if options["trouble"] == "killed":\n        __import__("os").kill('
            '__import__("os").getpid(), 9)\n    match options',
        )
    )
    (tmp_path / "tables.toml").write_text(TABLES)
    monkeypatch.setenv("DOFBENCH_METHODS", str(methods))
    # The fake method is written with the help of this folder.
    path = [str(Path(__file__).parent.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    options = {"data": "data", "tables": "tables.toml", "results": "results", "out": "out"}
    return [
        sys.executable,
        "-m",
        "dofbench",
        "ablate",
        "--seeds",
        "1",
        "--jobs",
        "2",
        *(word for name, value in options.items() for word in (f"--{name}", str(tmp_path / value))),
    ]


@pytest.mark.slow
def test_killed_in_the_middle_it_goes_on(command: list[str], tmp_path: Path) -> None:
    results = tmp_path / "results"
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        limit = time.monotonic() + LIMIT
        while not list(results.rglob("result.json")):
            assert time.monotonic() < limit and process.poll() is None
            time.sleep(0.02)
        process.kill()
    (kept,) = results.rglob("result.json")
    before = kept.stat().st_mtime_ns, kept.read_bytes()

    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
    # The process of one row is killed each time; the other rows are complete, and finished runs weren't repeated.
    assert done.returncode == 1, done.stderr
    assert "3 runs; 1 of them are finished" in done.stdout
    assert "killed by signal 9" in done.stderr
    assert (kept.stat().st_mtime_ns, kept.read_bytes()) == before
    assert len(list(results.rglob("result.json"))) == 2
    page = (tmp_path / "out" / "pauses.md").read_text()
    assert "crashed[^" in page and "the process died without a message" in page
    assert page.count("–") > 0 and "Difference from none" in page
