"""Budgets, overrides, and the command line that a result repeats."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dofbench.cli import app
from dofbench.core.budget import Budget, parse_budget
from dofbench.core.errors import InputError
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.run_spec import RunSpec, parse_overrides

STEPS = st.integers(1, 10**6)
SECONDS = st.integers(1, 99_999).map(lambda tenths: tenths / 10)


@given(steps=st.none() | STEPS, seconds=st.none() | SECONDS)
def test_a_budget_reads_back(steps: int | None, seconds: float | None) -> None:
    budget = Budget(steps, seconds)
    if steps is None and seconds is None:
        return
    assert parse_budget(str(budget)) == budget


def test_a_budget_of_many_digits_reads_back() -> None:
    for seconds in (1234567.0, 12.3456789):
        assert parse_budget(str(Budget(seconds=seconds))) == Budget(seconds=seconds)
    assert str(Budget(seconds=300.0)) == "300s"


def test_budget_takes_both_in_either_order() -> None:
    assert parse_budget("7000it, 300s") == parse_budget("300s,7000it") == Budget(7000, 300.0)
    assert parse_budget("5min,7000it") == parse_budget("7000it,300s") and parse_budget("1.5min") == Budget(None, 90.0)


def test_processor_seconds_are_told_from_seconds_of_the_clock() -> None:
    assert parse_budget("60cpu") == Budget(seconds=60.0, processor=True) != parse_budget("60s")
    assert parse_budget("100it,1.5cpu") == Budget(100, 1.5, processor=True)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "lots",
        "0s",
        "-1it",
        "nans",
        "infs",
        "1.5it",
        "3s,4s",
        "1min,4s",
        "min",
        "1it,2it",
        "300",
        ",",
        "cpu",
        "0cpu",
        "3s,4cpu",
    ],
)
def test_a_wrong_budget_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="budget"):
        parse_budget(text)


def test_overrides_are_typed() -> None:
    read = parse_overrides(("a=1", "b=1e-3", "c=true", "d=word", 'e="1"', "f=", "g=[1, 2]", "h=x=y"))
    assert read == {"a": 1, "b": 0.001, "c": True, "d": "word", "e": "1", "f": "", "g": [1, 2], "h": "x=y"}


@pytest.mark.parametrize("pairs", [("a",), ("=1",), ("a=1", "a=2")])
def test_wrong_overrides(pairs: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="--set"):
        parse_overrides(pairs)


def test_the_command_says_the_same_run() -> None:
    settings = RunSpec(
        method="fake", data=Path("some data"), set=("a=1", "b=x y"), seed=3, force_all=True, budget=Budget(9, 5.0)
    )
    words = shlex.split(settings.command())
    assert words[:2] == ["dofbench", "run"]
    assert app.parse(words[1:]).cells() == (settings,)


@pytest.mark.parametrize("kind", [RunSpec, MakeDataset])
def test_an_option_that_does_not_exist_is_refused(kind: type) -> None:
    with pytest.raises(InputError, match=r"nonsense.*\bseed\b"):
        kind(nonsense=3)
