"""Killed at random moments, as often as it takes: in the end every byte is as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal

import pytest
from called import called, dofbench, killed

from dofbench.cli import app
from dofbench.datasets.synthesis import check_dataset

LENSES = ("--assign", "fixed", "--focus", "0.2,0.8", "--aperture", "1")


def count(folder):
    """How many files there are, temporary ones too, that may come and go."""
    # os.walk passes over a folder that goes while it looks, as .work does at the end; rglob dies of it.
    return sum("." in name for _, folders, files in os.walk(folder) for name in (*folders, *files))


def kill_and_repeat(out, arguments, kills, seed, total):
    """Kill the command `kills` times, each when a random number of the `total` files is there; then let it finish.

    Returns how often it was killed while it was at work.
    """
    generator, command = random.Random(seed), dofbench("make-dataset", *arguments)
    hit = 0
    for _ in range(kills):
        enough = generator.randint(min(count(out) + 1, total), total)
        done = killed(command, lambda enough=enough: count(out) >= enough, delay=generator.uniform(0, 0.03))
        hit += done.returncode == -signal.SIGKILL
    done = called(command)
    assert done.returncode == 0, done.stderr
    return hit


@pytest.mark.slow
def test_one_dataset(scene, dataset_as_called, tmp_path, contents):
    out = tmp_path / "out"
    hit = kill_and_repeat(out, (scene, "--out", out), 5, 1, count(dataset_as_called))
    assert hit > 0
    assert contents(out) == contents(dataset_as_called)


@pytest.mark.slow
def test_several_datasets_side_by_side(scene, write_scene, tmp_path, contents):
    other = write_scene(tmp_path / "other")
    arguments = (scene, other, *LENSES, "--jobs", "2")
    assert app.main(["make-dataset", *map(str, arguments), "--out", str(tmp_path / "whole")]) == 0
    total = count(tmp_path / "whole")
    hit = kill_and_repeat(tmp_path / "out", (*arguments, "--out", tmp_path / "out"), 3, 1, total)
    assert hit > 0
    names = sorted(path.name for path in (tmp_path / "whole").iterdir())
    assert names == ["other-F0.2-A1", "other-F0.8-A1", "planes-F0.2-A1", "planes-F0.8-A1"]
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert all(check_dataset(tmp_path / "out" / name) == [] for name in names)
