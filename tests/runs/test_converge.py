"""Trainings of doubled length: the rule, rounds, resuming, and wrong calls."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from fake_method import fake_run
from harness_fakes import Here
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from dofbench.cli import app
from dofbench.cli.run_methods import run_methods
from dofbench.core.budget import parse_budget
from dofbench.core.errors import InputError
from dofbench.evaluation.results.collecting import collect
from dofbench.running import convergence, run_options
from dofbench.running.convergence import LEAST_GAIN, MOST_MINUTES, MOST_STEPS, Length, verdict
from dofbench.running.run_options import HELD_OUT, Runs


def words(*lengths: Length) -> str:
    return verdict(lengths).words


def test_the_rule() -> None:
    assert verdict([Length(1000, 20.0)]).goes_on
    assert verdict([Length(1000, 20.0), Length(2000, 20.1001)]).goes_on
    assert words(Length(1000, 20.0), Length(2000, 20.0999)) == "converged at 2000 steps"
    assert words(Length(1000, 20.0), Length(2000, 19.0)) == "converged at 2000 steps"
    assert verdict([Length(15_000, 20.0)]).goes_on
    assert words(Length(15_001, 20.0)) == "not converged at 15001 steps: limit of 30000 steps"
    assert verdict([Length(1000, 20.0, 1200.0)]).goes_on
    assert words(Length(1000, 20.0, 1200.1)) == "not converged at 1000 steps: limit of 40 minutes"
    assert words(Length(1000)) == "failed at 1000 steps: no finite held-out PSNR"
    assert words(Length(1000, failure="crashed: no memory")) == "failed at 1000 steps: crashed: no memory"


@given(st.integers(1, 40_000), st.floats(0.01, 3000.0), st.lists(st.floats(-1.0, 3.0), max_size=20))
def test_no_training_but_the_first_exceeds_a_limit(steps: int, seconds: float, gains: list[float]) -> None:
    lengths, psnr = [Length(steps, 20.0, seconds)], 20.0
    for gain in gains:
        if not verdict(lengths).goes_on:
            break
        psnr += gain
        lengths.append(Length(2 * lengths[-1].steps, psnr, 2 * lengths[-1].seconds))
    for before, after in pairwise(lengths):
        assert after.steps <= MOST_STEPS and after.seconds <= 60 * MOST_MINUTES
        assert after is lengths[-1] or after.psnr - before.psnr >= LEAST_GAIN


def test_the_help_states_the_rule() -> None:
    said = " ".join(Path(run_options.__file__).read_text().split())
    assert f"rises by less than {LEAST_GAIN:g} dB" in said
    assert f"exceed {MOST_STEPS} steps or {MOST_MINUTES} minutes" in said
    assert f"Holds {100 * HELD_OUT:g} % of the pixels out" in said


@pytest.fixture
def converge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[bool, list[str], str]]:
    """`converge(noise=…)`: whether all went well, the runs made, what was said."""
    fake_run(tmp_path, monkeypatch)

    def call(fatal: int | None = None, **changes) -> tuple[bool, list[str], str]:
        here, stream = Here(fatal), io.StringIO()
        chosen = {"method": "fake", "data": str(tmp_path / "data"), "out": tmp_path / "results", "converge": True}
        good = run_methods(Runs(**{**chosen, **changes}), Console(file=stream, width=400), here)
        return good, here.made, stream.getvalue()

    return call


def test_lengths_double_until_the_score_stops_rising(converge, tmp_path: Path) -> None:
    good, made, said = converge()
    found = {int(one.spec.budget.removesuffix("it")): one for one in collect(tmp_path / "results").entries}
    steps = sorted(found)
    assert good and len(made) == len(steps) > 2 and steps == [8 * 2**k for k in range(len(steps))]
    scores = [found[length].scores["held_out_psnr"] for length in steps]
    gains = [after - before for before, after in pairwise(scores)]
    assert all(gain >= LEAST_GAIN for gain in gains[:-1]) and gains[-1] < LEAST_GAIN
    shown = " → ".join(f"{score:.2f}" for score in scores)
    assert f"fake (quick, seed 0) on waves: converged at {steps[-1]} steps; held-out PSNR {shown} dB at 8, 16" in said
    assert all(one.spec.held_out == HELD_OUT and "--held-out 0.05" in one.result.command for one in found.values())
    assert {one.preset for one in found.values()} == {"quick held_out=0.05"}


def test_only_cells_that_still_gain_go_on(converge, tmp_path: Path) -> None:
    good, made, said = converge(method="fake", preset="quick,slow", set=("noise=0.001",))
    assert good and len(made) == 4  # no noise to lose: the first doubling ends both
    assert "converged at 16 steps" in said and "converged at 24 steps" in said
    good, made, said = converge(method="fake", preset="quick,slow", out=tmp_path / "other")  # noise 0.1 and 0.2
    lengths = {preset: sum(f"fake-{preset}-" in name for name in made) for preset in ("quick", "slow")}
    assert good and len(set(lengths.values())) == 2 and "1 of 2 go on, to " in said


def test_an_interrupted_call_goes_on_where_it_was(converge, tmp_path: Path) -> None:
    whole = converge(out=tmp_path / "whole")[1]
    with pytest.raises(KeyboardInterrupt):  # in its third round
        converge(fatal=2)
    before = {file: file.read_bytes() for file in (tmp_path / "results").rglob("result.json")}
    _, made, said = converge()
    assert len(before) == 2 and len(made) == len(whole) - len(before) and "converged at" in said
    assert all(file.read_bytes() == content for file, content in before.items())
    assert converge()[:2] == (True, [])


def test_a_cell_that_fails_stops_alone(converge) -> None:
    good, made, said = converge(preset="quick,slow", set=("trouble=crash", "at=20", "noise=0.1"))
    assert not good and len(made) >= 4
    assert "failed at 24 steps: crashed: RuntimeError: something broke" in said  # slow, of 12 steps at first
    assert "held-out PSNR" in said and "failed at 32 steps" in said
    assert len(re.findall("^failed: ", said, re.MULTILINE)) == 2


def test_a_dry_run_states_the_rule_and_the_first_round(converge, tmp_path: Path) -> None:
    good, made, said = converge(dry_run=True)
    assert good and not made and not (tmp_path / "results").exists()
    assert convergence.RULE in said and "budget 8it" in said and "5.0% of the training views' pixels held out" in said


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"budget": (parse_budget("60s"),)}, "--budget: found 60s with --converge"),
        ({"budget": (parse_budget("5it"), parse_budget("6it"))}, "--budget: found 5it, 6it with --converge"),
        ({"held_out": 1.0}, "--held-out: found 1, expected less than 1"),
        ({"held_out": -0.1}, "--held-out: found -0.1, expected at least 0"),
        ({"held_out": math.nan}, "--held-out"),
        ({"photographs": Path("photographs"), "data": None}, "--converge: found --photographs too"),
    ],
)
def test_impossible_calls(converge, changes: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        converge(**changes)


def test_a_method_without_predictions_or_steps_is_refused(converge, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "pinhole" / "trainer.py"
    code.write_text(code.read_text().replace("def predict_photograph", "def _predict_photograph"))
    with pytest.raises(InputError, match="--converge: found pinhole, which doesn't predict its training views"):
        converge(method="fake,pinhole")
    card = tmp_path / "methods" / "fake" / "method.toml"
    card.write_text(card.read_text().replace('"8it"', '"8s"'))
    with pytest.raises(InputError, match="preset quick of fake: found a budget in time, 8s, with --converge"):
        converge(method="fake")
    assert not (tmp_path / "results").exists()


def test_a_wrong_share_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main("run --method a --held-out 1.5".split()) == 2
    assert capsys.readouterr().err.count("\n") == 1
