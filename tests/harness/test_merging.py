"""Results that several machines made, in folders of their own or in a shared one: each run counts once."""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
from pathlib import Path

import pytest
from harness_fakes import Here, text_console
from rich.console import Console

from dofbench.cli.run_methods import run_methods
from dofbench.core.errors import InputError, Status
from dofbench.core.jobs import Busy, Resources
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.result import read_result, write_result
from dofbench.evaluation.results.run_lease import run_lease
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report
from dofbench.running import execution
from dofbench.running.one_run import run_job
from dofbench.running.plan import make_plan
from dofbench.running.run_options import Runs
from dofbench.runtime import leases


def another_machine(monkeypatch: pytest.MonkeyPatch, name: str = "another one") -> None:
    """From now on leases are those of another machine than before."""
    monkeypatch.setattr(leases, "_machine", lambda: name)


@pytest.mark.slow
def test_folders_of_several_machines_are_merged_by_key(call, tmp_path: Path) -> None:
    first, second = call(), call(seed=1)
    other = tmp_path / "other"
    shutil.copytree(tmp_path / "results", other)
    shutil.rmtree(second.folder)
    third = call(seed=2)
    merged = collect(tmp_path / "results", other)
    assert [entry.spec.seed for entry in merged.entries] == [0, 1, 2]
    assert [entry.folder for entry in merged.entries] == [
        first.folder,
        other / second.folder.relative_to(tmp_path / "results"),
        third.folder,
    ]
    assert merged.doubles == (other / first.folder.relative_to(tmp_path / "results"),)
    console, stream = text_console()
    assert write_report(Report(tmp_path / "results", tmp_path / "board", merge=(other,)), console)
    rows = (tmp_path / "board" / "leaderboard.csv").read_text().splitlines()
    assert len(rows) == 4 and "a copy of another result" in stream.getvalue()


def test_results_on_another_disk_count_through_a_link(call, tmp_path: Path) -> None:
    first, second = call(), call(seed=1)
    disk = tmp_path / "disk"
    shutil.move(second.folder, disk / second.folder.name)
    second.folder.symlink_to(disk / second.folder.name)
    merged = collect(tmp_path / "results")
    assert [(entry.spec.seed, entry.folder) for entry in merged.entries] == [(0, first.folder), (1, second.folder)]
    assert merged.doubles == ()


@pytest.mark.parametrize("bad", [Status.CRASHED, Status.OUT_OF_MEMORY, Status.DIVERGED])
@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_with_one_key_the_one_that_went_best_counts(call, tmp_path: Path, bad: Status, swapped: bool) -> None:
    end = call()
    other = tmp_path / "other" / end.folder.name
    shutil.copytree(end.folder, other)
    worse = other if swapped else end.folder
    write_result(worse, read_result(worse).model_copy(update={"status": bad, "message": "no"}))
    for folders in [(tmp_path / "results", tmp_path / "other"), (tmp_path / "other", tmp_path / "results")]:
        merged = collect(*folders)
        assert [(entry.status, entry.folder) for entry in merged.entries] == [
            (Status.OK, end.folder if swapped else other)
        ]
        assert merged.doubles == (worse,)


def test_a_run_that_died_on_one_machine_and_was_finished_on_another_is_one(call, tmp_path: Path) -> None:
    end = call()
    died = tmp_path / "other" / end.folder.name
    died.mkdir(parents=True)
    note = {"started": "noon", "scene": "waves", "spec": read_result(end.folder).spec.model_dump()}
    (died / "running.lock").write_text(json.dumps(note))
    assert [entry.status for entry in collect(tmp_path / "other").entries] == [Status.CRASHED]
    assert [entry.status for entry in collect(tmp_path / "other", tmp_path / "results").entries] == [Status.OK]


@pytest.mark.slow
def test_a_run_of_a_machine_that_is_gone_is_made_by_another(
    call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two machines share a folder; one dies. The other leaves that run for the last, waits, and makes it."""
    end = call()
    spec = read_result(end.folder).spec
    shutil.rmtree(end.folder)
    end.folder.mkdir(parents=True)
    lease = end.folder / "running.lock"
    note = {"machine": "gone", "started": "noon", "scene": "waves", "spec": spec.model_dump()}
    lease.write_text(json.dumps(note))
    monkeypatch.setattr(leases, "EXPIRES_AFTER", 600.0)
    settings = Runs(method="fake,pinhole", data=str(tmp_path / "data"), out=tmp_path / "results")
    console, stream = text_console()
    run_methods(Runs(**{**vars(settings), "dry_run": True}), console, Here())
    assert "at work in another process" in stream.getvalue()
    threading.Timer(1.0, os.utime, (lease, (0, 0))).start()
    begun = time.monotonic()
    assert run_methods(settings, Console(quiet=True), Here())
    assert time.monotonic() - begun > 0.9  # it waited
    assert read_result(end.folder).status is Status.OK and not list(end.folder.glob("running*"))


def test_two_commands_that_begin_one_run_at_a_moment_share_the_rest(call, tmp_path: Path) -> None:
    """Neither saw the other when it chose the run. The second one leaves it for later instead of waiting beside it."""
    end = call()
    result = read_result(end.folder)
    planned = make_plan(RunSpec(method="fake", data=tmp_path / "data", out=tmp_path / "results"), tmp_path / "data")
    assert planned.folder == end.folder
    job = run_job(planned, Resources())
    with run_lease(end.folder, result.spec, "waves", "now"), pytest.raises(Busy):
        job.work(lambda report: None)
    assert job.insist is not None and job.insist(lambda report: None).endswith("by another process")


def test_who_lost_its_run_to_another_machine_writes_no_result(
    call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It slept while it trained; meanwhile another machine made the run. The other's result stays as it is."""
    end = call()
    theirs = (end.folder / "result.json").read_bytes()
    original = execution.Execution._train

    def asleep(self):
        trained = original(self)
        (end.folder / "running.lock").unlink()  # by the one that took it over, and has finished
        (end.folder / "result.json").write_bytes(theirs)
        return trained

    monkeypatch.setattr(execution.Execution, "_train", asleep)
    with pytest.raises(InputError, match="took this work over"):
        call(rerun=True)
    assert (end.folder / "result.json").read_bytes() == theirs
