"""Estimates of the time of runs: from finished runs, from the method's card, from the budget, or unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from harness_fakes import text_console

from dofbench.cli.run_methods import run_methods
from dofbench.core.budget import parse_budget
from dofbench.core.jobs import Outcome, Resources
from dofbench.core.progress import Several
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.methods.cards import Costs, find_method
from dofbench.running.plan import make_plan
from dofbench.running.run_options import Runs
from dofbench.running.time_estimate import expected, seconds_by_card, time_to_go

PIXELS = 64 * 48
COSTS = "[costs]\nstep = 0.5\nstep_pixel = 1e-3\nview_pixel = 2e-3\n"


def planned(tmp_path: Path, budget: str | None = None, seed: int = 0):
    given = None if budget is None else parse_budget(budget)
    return make_plan(
        RunSpec(method="fake", data=tmp_path / "data", out=tmp_path / "results", budget=given, seed=seed),
        tmp_path / "data",
    )


@pytest.fixture
def with_costs(call, tmp_path: Path) -> None:
    card = tmp_path / "methods" / "fake" / "method.toml"
    card.write_text(card.read_text() + COSTS)


@pytest.mark.parametrize(
    ("budget", "training"),
    [("8it", 8 * (0.5 + 1e-3 * PIXELS)), ("2s", 2.0), ("8it,2s", 2.0)],
)
def test_by_the_card(with_costs, tmp_path: Path, budget: str, training: float) -> None:
    found = expected(planned(tmp_path, budget), []).seconds
    # Two test views are scored, at the end and along the training; four views are looked at before the first step.
    others = 8 + 2 * PIXELS * (1e-5 + 1e-5)
    assert found == pytest.approx(training + 4 * PIXELS * 2e-3 + others)


@pytest.mark.parametrize(("budget", "training"), [("2s", 2.0), ("8it,2s", 2.0), ("1it,2s", 0.5)])
def test_seconds_alone_are_all_used_however_short_the_preset(budget: str, training: float) -> None:
    """The preset's three steps take 1.5 s, less than the budget's seconds."""
    card = find_method("mipsplatting").card.model_copy(update={"costs": Costs(step=0.5, step_pixel=0.0)})
    sizes = {"view_pixels": 0.0, "train_views": 0, "test_views": 0, "fitted": False}
    found, no_training = (seconds_by_card(card, parse_budget(text), 3, **sizes) for text in (budget, "1e-9s"))
    assert found is not None and no_training is not None and found - no_training == pytest.approx(training)


def test_without_a_card_s_costs_nobody_knows(call, tmp_path: Path) -> None:
    assert expected(planned(tmp_path), []) == Resources("cpu")
    assert "says nothing" in time_to_go([Resources()], 1, "")


def test_what_a_cpu_took_says_nothing_of_a_gpu(with_costs, call, tmp_path: Path) -> None:
    run = planned(tmp_path, "8it,2s", seed=3)
    there = replace(run, spec=run.spec.model_copy(update={"device": "cuda"}))
    others = 8 + 2 * PIXELS * (1e-5 + 1e-5)
    for finished in ([], [read_result(call(seed=0).folder)]):
        found = expected(there, finished)
        assert found.device == "cuda" and found.seconds == pytest.approx(2.0 + others)  # by the budget alone


def test_by_runs_that_are_finished(with_costs, call, tmp_path: Path) -> None:
    ends = [read_result(call(seed=seed).folder) for seed in (0, 1, 2)]
    found = expected(planned(tmp_path, seed=3), ends)
    assert found.seconds is not None and found.seconds < 5  # what they took, not what the card says
    assert found.memory_mb == sorted(end.scores["peak_mb"] for end in ends)[1]
    longer = expected(planned(tmp_path, "800it", seed=3), ends)
    assert longer.seconds is not None and longer.seconds > found.seconds
    other = make_plan(RunSpec(method="pinhole", data=tmp_path / "data", out=tmp_path / "results"), tmp_path / "data")
    assert expected(other, ends).memory_mb is None  # another method's says nothing of its memory


def test_one_run_says_before_it_begins_how_long_it_will_take(with_costs, tmp_path: Path) -> None:
    settings = Runs(method="fake", data=str(tmp_path / "data"), out=tmp_path / "results")
    console, stream = text_console()
    assert run_methods(settings, console)
    said = stream.getvalue()
    before, _, _ = said.partition("JIT compilation")
    assert len(before.splitlines()) <= 5 and "about 61 s to go" in before and "8it" in before
    console, stream = text_console()
    assert run_methods(settings, console)
    assert "using the cached result" in stream.getvalue()
    assert "to go" not in stream.getvalue()
    console, stream = text_console()
    assert run_methods(Runs(**{**vars(settings), "seed": 2, "verbose": True}), console)
    assert "to be run, about " in stream.getvalue() and stream.getvalue().count("budget 8it; ") == 1
    console, stream = text_console()
    assert run_methods(Runs(**{**vars(settings), "seed": 1, "dry_run": True}), console)
    assert "by finished runs" in stream.getvalue() and "61 s" not in stream.getvalue()


def test_the_time_left_of_several_follows_what_each_is_expected_to_take(capsys, monkeypatch) -> None:
    now = 0.0
    monkeypatch.setattr("dofbench.core.progress.time.monotonic", lambda: now)
    several = Several(3, 1, interval=0, things="runs", expected={"short": 10.0, "long": 100.0})
    several.started("short")
    several.reported("short", ("step", 1, 5))
    now = 20.0  # twice as long as was expected
    several.ended(Outcome("short", "done"))
    several.started("long")
    now = 70.0
    several.reported("long", ("step", 1, 5))
    lines = capsys.readouterr().err.splitlines()
    assert "about 165 s left" in lines[0]  # 10 + 100, and 55 for the one of which nobody knows
    assert "about 310 s left" in lines[1]  # 200, and the mean of 20 and 200
    assert "about 260 s left" in lines[2]
