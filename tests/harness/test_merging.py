"""Results that several machines made, in folders of their own or in a shared one: each run counts once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from harness_fakes import text_console

from dofbench.core.errors import Status
from dofbench.core.jobs import Busy, Resources
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.result import read_result, write_result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report
from dofbench.running.one_run import run_job
from dofbench.running.plan import make_plan


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


def test_two_commands_that_begin_one_run_at_a_moment_share_the_rest(call, tmp_path: Path) -> None:
    """Neither saw the other when it chose the run. The second one leaves it, and takes the first one's result."""
    end = call()
    result = read_result(end.folder)
    planned = make_plan(RunSpec(method="fake", data=tmp_path / "data", out=tmp_path / "results"), tmp_path / "data")
    assert planned.folder == end.folder
    job = run_job(planned, Resources())
    assert not job.busy() and job.done().endswith("by another process")
    with run_lock(end.folder, result.spec, "waves", "now"):
        assert job.busy()
        with pytest.raises(Busy):
            job.work(lambda report: None)
    (end.folder / "result.json").unlink()
    assert not job.busy() and not job.done()
