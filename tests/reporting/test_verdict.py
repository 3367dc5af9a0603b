"""The best row, its lead, and whether the lead is significant by the test of per-view differences."""

from __future__ import annotations

from pathlib import Path

import pytest

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.result import Result, Spec, ViewScores
from dofbench.reporting.summary import Line, Statistic
from dofbench.reporting.verdict import Verdict, verdicts

NOBODY = dict.fromkeys(("preset", "budget", "dataset", "dataset_checksum", "protocol", "device", "code"), "x")


def entry(method: str, seed: int, views: list[float], status: Status = Status.OK) -> Entry:
    """A run with the only scores that a verdict needs: its refocus PSNR by view."""
    spec = Spec(method=method, seed=seed, overrides={}, options={}, **NOBODY)
    scored = [ViewScores(name=f"v{index}", scores={"psnr": value}) for index, value in enumerate(views)]
    result = Result.model_construct(scores={"psnr": sum(views) / len(views)}, views=scored)
    return Entry(Path(), spec, "", status, "", result)


A, B, C = (entry(method, 0, [0.0]).variant for method in "abc")


def lines(entries: list[Entry]) -> dict[tuple[str, ...], Line]:
    """Their means over seeds."""
    found = {}
    for variant in dict.fromkeys(one.variant for one in entries):
        values = [one.scores["psnr"] for one in entries if one.variant == variant]
        cells = {"psnr": Statistic(sum(values) / len(values)), "aif_psnr": Statistic(None, reason="not asked")}
        found[variant] = Line(variant[0], "", "", cells)
    return found


def verdict(found: dict[tuple[str, ...], Line], *boards: list[Entry]) -> Verdict | None:
    """The only verdict on one table, None if there is none."""
    (*told,) = verdicts(
        found, [{variant: [e for e in runs if e.variant == variant] for variant in found} for runs in boards]
    )
    assert len(told) < 2
    return told[0] if told else None


VIEWS = [30.0, 31.0, 32.0, 28.0, 29.5, 33.0, 30.5, 31.5]


def test_views_are_compared_in_pairs() -> None:
    ahead = [0.9, 1.1, 1.0, 0.8, 1.2, 1.0, 0.95, 1.05]
    entries = [entry("b", seed, VIEWS) for seed in range(3)]
    entries += [entry("a", seed, [v + d for v, d in zip(VIEWS, ahead, strict=True)]) for seed in range(3)]
    found = verdict(lines(entries), entries)
    assert (found.best, found.second, found.sure.kind) == (A, B, "sure") and found.ahead == pytest.approx(1.0)
    # All eight differences have one sign: of 2 ** 8 choices of signs, two are as extreme.
    assert found.sure.text == "over 8 test views, 3 seeds; +1.00"
    assert (found.sure.test.p, found.sure.test.verdict) == (f"p = {2 / 2**8:.3f}", "better")


def test_what_the_test_does_not_bear_is_not_called_better() -> None:
    off = (3, -2, 1, -1, 2, -1, 0.5, -0.5)
    entries = [entry("b", 0, VIEWS), entry("a", 0, [v + d for v, d in zip(VIEWS, off, strict=True)])]
    found = verdict(lines(entries), entries)
    assert found.best == A and found.sure.kind == "unsure" and found.sure.below == "not told apart"


def test_few_views_tell_nothing_apart_and_one_seed_is_said() -> None:
    entries = [entry("a", 0, [30.0, 33.0, 29.0]), entry("b", 0, [29.0, 31.0, 28.0])]
    found = verdict(lines(entries), entries)
    assert found.best == A and found.sure.kind == "unsure"
    assert found.sure.text.startswith("over 3 test views, one seed: what another would change is unknown; +1.33")


def test_a_failed_run_is_not_tested() -> None:
    entries = [entry("a", 0, VIEWS), entry("b", 0, [v - 1 for v in VIEWS], Status.CRASHED)]
    found = verdict(lines(entries), entries)
    assert found.sure.kind == "untested" and found.sure.text.startswith("not tested")


def test_the_second_is_the_next_best_and_a_gap_is_no_rival() -> None:
    entries = [entry("a", 0, [20.0]), entry("b", 0, [30.0]), entry("c", 0, [29.5])]
    found = lines(entries)
    found[A] = Line("a", "", "", {"psnr": Statistic(None, failure="crashed"), "aif_psnr": Statistic(None)})
    told = verdict(found, entries)
    assert (told.best, told.second) == (B, C) and told.ahead == pytest.approx(0.5)
    found[C] = Line("c", "", "", {"psnr": Statistic(float("nan")), "aif_psnr": Statistic(None)})
    told = verdict(found, entries)
    assert (told.best, told.second, told.sure.text) == (B, None, "nothing to compare it with")


def test_a_mean_is_tested_over_the_views_of_all_scenes() -> None:
    """Three views tell nothing apart on one scene; those of two scenes do."""
    one = [entry("a", 0, [30.0, 33.0, 29.0]), entry("b", 0, [29.0, 31.5, 28.2])]
    two = [entry("a", 0, [20.0, 23.0, 19.0]), entry("b", 0, [19.1, 21.8, 17.9])]
    found = verdict(lines(one + two), one, two)
    assert (found.best, found.second, found.sure.kind) == (A, B, "sure")
    assert found.sure.text.startswith("over 6 test views") and found.sure.test.p == f"p = {2 / 2**6:.3f}"
    assert verdict(lines(one), one).sure.kind == "unsure"
    # Not told apart where one of them wasn't run on a scene.
    assert verdict(lines(one), one, two[:1]).sure.kind == "untested"


def test_refocusing_and_sharp_views_have_verdicts_of_their_own() -> None:
    def line(name: str, **scores: float | None) -> Line:
        known = dict.fromkeys(("psnr", "aif_psnr"))
        return Line(name, "", "", {column: Statistic(value) for column, value in (known | scores).items()})

    table = {A: line("a", psnr=30.0, aif_psnr=24.0), B: line("b", aif_psnr=25.0), C: line("c", psnr=29.0)}
    told = [(one.column, one.best, one.second) for one in verdicts(table, [{}])]
    assert told == [("psnr", A, C), ("aif_psnr", B, A)]
    without = {A: line("a", aif_psnr=25.0)}
    assert [one.column for one in verdicts(without, [])] == ["aif_psnr"]
    assert verdicts({A: line("a")}, []) == ()


def test_of_two_scores_of_photographs_the_first_decides() -> None:
    cells = {"photo_psnr": Statistic(20.0), "across_psnr": Statistic(21.0)}
    assert [one.column for one in verdicts({A: Line("a", "", "", cells)}, [])] == ["photo_psnr"]
    del cells["photo_psnr"]
    assert [one.column for one in verdicts({A: Line("a", "", "", cells)}, [])] == ["across_psnr"]
