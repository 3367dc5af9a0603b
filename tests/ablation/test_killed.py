"""The command as a user calls it, in processes of its own, killed in the middle and called again."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from called import called, dofbench, fake_method_and_data, killed

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


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`dofbench ablate` on a small dataset, with a method that costs nothing, two runs at a time."""
    behaviour = fake_method_and_data(tmp_path, monkeypatch, width=64) / "behaviour.py"
    behaviour.write_text(
        behaviour.read_text().replace(
            "    match options",
            '    if options["trouble"] == "killed":\n        __import__("os").kill('
            '__import__("os").getpid(), 9)\n    match options',
        )
    )
    (tmp_path / "tables.toml").write_text(TABLES)
    options = {"data": "data", "tables": "tables.toml", "results": "results", "out": "out"}
    words = (word for name, value in options.items() for word in (f"--{name}", tmp_path / value))
    return dofbench("ablate", "--seeds", 1, "--jobs", 2, *words)


@pytest.mark.slow
def test_killed_in_the_middle_it_goes_on(command: list[str], tmp_path: Path) -> None:
    results = tmp_path / "results"
    done = killed(command, lambda: bool(list(results.rglob("result.json"))))
    assert done.returncode == -signal.SIGKILL, done.stdout
    (kept,) = results.rglob("result.json")
    before = kept.stat().st_mtime_ns, kept.read_bytes()

    done = called(command)
    # The process of one row is killed each time; the other rows are complete, and finished runs weren't repeated.
    assert done.returncode == 1, done.stderr
    assert "3 runs, 1 of them cached" in done.stdout
    assert "killed by signal 9" in done.stderr
    assert (kept.stat().st_mtime_ns, kept.read_bytes()) == before
    assert len(list(results.rglob("result.json"))) == 2
    page = (tmp_path / "out" / "pauses.md").read_text()
    assert "crashed[^" in page and "the process died without a message" in page
    assert page.count("–") > 0 and "Difference from none" in page
