"""The training cases of a method from outside: those that need no options of this project's trainer."""

from __future__ import annotations

import pytest
from fake_method import write_method

from dofbench.evaluation.stability.catalogue import catalogue, chosen
from dofbench.evaluation.stability.stability_options import Stability


@pytest.fixture
def outside(tmp_path, monkeypatch):
    """A method of another trainer, by id."""
    known = {case.subject for case in catalogue() if case.group == "training"}
    monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods")))
    found = {case.subject for case in catalogue() if case.group == "training"} - known
    assert len(found) == 1
    return found.pop()


def test_a_method_from_outside_gets_hard_scenes_and_none_of_our_options(outside):
    names = {case.name.removeprefix(f"{outside}-") for case in chosen(Stability(method=outside))}
    assert names == {
        "3-views",
        "around",
        "textureless",
        "noise",
        "only-noise",
        "wrong-pose",
        "one-black",
        "all-black",
        "photograph-nan",
        "photograph-inf",
    }


def test_it_is_run_and_what_it_says_is_looked_at(outside):
    case = next(case for case in chosen(Stability(method=outside)) if case.name.endswith("3-views"))
    found = case.measure(case.settings[0])
    assert "of 2" in found.note
