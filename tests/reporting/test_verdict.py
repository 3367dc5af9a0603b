"""Which row is best, by how much, and how sure: against the paired test done by hand."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from scipy.stats import ttest_rel
from tolerances import PRINTED_P

from dofbench.errors import Status
from dofbench.reporting.summary import Cell, Line
from dofbench.reporting.verdict import verdict

A, B, C = ("a",), ("b",), ("c",)


def entry(variant: tuple[str, ...], seed: int, views: list[float], status: Status = Status.OK) -> SimpleNamespace:
    """A run, as far as a verdict looks at it: its refocus PSNR by view."""
    mean = sum(views) / len(views)
    result = SimpleNamespace(views=[SimpleNamespace(name=f"v{index}", scores={"psnr": value})
                                    for index, value in enumerate(views)])
    return SimpleNamespace(variant=variant, spec=SimpleNamespace(seed=seed), status=status, scores={"psnr": mean},
                           result=result)


def lines(entries: list[SimpleNamespace]) -> dict[tuple[str, ...], Line]:
    """Their means over seeds."""
    found = {}
    for variant in dict.fromkeys(one.variant for one in entries):
        values = [one.scores["psnr"] for one in entries if one.variant == variant]
        cells = {"psnr": Cell(sum(values) / len(values)), "aif_psnr": Cell(None, reason="not asked")}
        found[variant] = Line(variant[0], "", "", cells)
    return found


def test_seeds_are_compared_in_pairs() -> None:
    a, b = [30.0, 31.0, 32.0], [29.0, 30.1, 30.9]
    entries = [entry(A, seed, [value]) for seed, value in enumerate(a)]
    entries += [entry(B, seed, [value]) for seed, value in enumerate(b)]
    found = verdict(lines(entries), entries)
    p = float(ttest_rel(a, b).pvalue)
    assert (found.best, found.second, found.told_apart) == (A, B, True) and found.ahead == pytest.approx(1.0)
    assert "over 3 seeds in pairs: +1.00 ± 0.10 dB" in found.sure and found.sure.endswith("better")
    assert float(found.sure.partition("p = ")[2].partition(":")[0]) == pytest.approx(p, abs=PRINTED_P)


def test_what_the_test_does_not_bear_is_not_called_better() -> None:
    entries = [entry(A, seed, [value]) for seed, value in enumerate((30.0, 29.0, 33.0))]
    entries += [entry(B, seed, [value]) for seed, value in enumerate((29.0, 31.0, 30.0))]
    found = verdict(lines(entries), entries)
    assert found.best == A and found.told_apart is False and found.sure.endswith("not told apart")


def test_one_seed_tests_nothing_and_the_views_are_told() -> None:
    entries = [entry(A, 0, [30.0, 33.0, 29.0]), entry(B, 0, [29.0, 31.0, 30.0])]
    found = verdict(lines(entries), entries)
    assert found.best == A and found.told_apart is None
    assert found.sure.startswith("one seed in common: what another seed would change is unknown")
    assert "ahead on 2 of them" in found.sure and "over the 3 test views +0.67 ± 1.53 dB" in found.sure


def test_seeds_that_are_not_shared_are_no_pairs() -> None:
    entries = [entry(A, 0, [30.0]), entry(B, 5, [29.0])]
    assert verdict(lines(entries), entries).sure.startswith("no seed in common")


def test_the_second_is_the_next_best_and_a_gap_is_no_rival() -> None:
    entries = [entry(A, 0, [20.0]), entry(B, 0, [30.0]), entry(C, 0, [29.5])]
    found = lines(entries)
    found[A] = Line("a", "", "", {"psnr": Cell(None, failure="crashed"), "aif_psnr": Cell(None)})
    told = verdict(found, entries)
    assert (told.best, told.second) == (B, C) and told.ahead == pytest.approx(0.5)
    found[C] = Line("c", "", "", {"psnr": Cell(float("nan")), "aif_psnr": Cell(None)})
    told = verdict(found, entries)
    assert (told.best, told.second, told.sure) == (B, None, "nothing to compare it with")


def test_all_in_focus_decides_where_nothing_refocuses() -> None:
    cells = {"psnr": Cell(None, reason="no lens"), "aif_psnr": Cell(25.0)}
    assert verdict({A: Line("a", "", "", cells)}, []).column == "aif_psnr"
    assert verdict({A: Line("a", "", "", {"psnr": Cell(None), "aif_psnr": Cell(None)})}, []) is None
