"""A running training is watched: its snapshots are found, replaced, and end in the finished run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dofbench.core.jobs import Outcome
from dofbench.core.lens import ApertureShape
from dofbench.running import snapshots
from dofbench.running.load_run import load_run
from dofbench.running.snapshots import SNAPSHOT_FOLDER, Snapshots, found, read_snapshot
from dofbench.viewing import subject as module
from dofbench.viewing.subject import open_subject

Call = Callable[..., Outcome]


def test_a_run_is_shown_while_it_trains(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step is saved here, and looked at as a viewer would."""
    monkeypatch.setattr(snapshots, "EVERY", 0.0)
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    seen, opened = [], []
    saved = Snapshots.save

    def save(self: Snapshots, step: int) -> None:
        saved(self, step)
        run = self._folder.parent
        opened.append(opened[0] if opened else open_subject(run))
        now[0] += 2
        seen.append(opened[0].version())
        camera = opened[0].photographs[0].camera
        assert opened[0].render(camera, None, ApertureShape()).image.shape == (camera.height, camera.width, 3)

    monkeypatch.setattr(Snapshots, "save", save)
    end = call(watch=True)
    assert seen == list(range(1, 9)), "each step's snapshot was found"
    assert not (end.folder / SNAPSHOT_FOLDER).exists()
    now[0] += 2
    assert opened[0].version() == 9, "the finished run"
    camera = opened[0].photographs[0].camera
    expected = load_run(end.folder).method.render(camera, None).image
    assert np.array_equal(opened[0].render(camera, None, ApertureShape()).image, expected)
    assert "in training" in opened[0].name and "in training" not in open_subject(end.folder).name


def test_watching_changes_nothing_but_time(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots, "EVERY", 0.0)
    watched = load_run(call(watch=True).folder).result
    plain = load_run(call(out=tmp_path / "plain").folder).result
    assert watched.key == plain.key and watched.model == plain.model and "--watch" not in watched.command


def test_few_snapshots_are_kept_and_only_whole_ones(call: Call, tmp_path: Path) -> None:
    run = load_run(call().folder)
    keeper = Snapshots(tmp_path / "run", run.method, run.result.spec, run.data)
    for step in (5, 10, 15):
        keeper.save(step)
    assert [path.name for path in found(tmp_path / "run")] == ["00000010", "00000015"]
    assert read_snapshot(found(tmp_path / "run")[-1])[3] == 15
    (tmp_path / "run" / SNAPSHOT_FOLDER / ".00000020.part").mkdir()
    assert len(found(tmp_path / "run")) == 2
