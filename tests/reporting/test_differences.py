"""Which values are paired: scores by view, costs by seed; and when there is nothing to pair."""

from __future__ import annotations

from pathlib import Path

import pytest

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.result import Result, Spec, ViewScores
from dofbench.reporting.differences import adjusted, compare

NOBODY = dict.fromkeys(("preset", "budget", "dataset", "dataset_checksum", "protocol", "device", "code"), "x")


def entry(method: str, seed: int, views: dict[str, float], seconds: float, status: Status = Status.OK) -> Entry:
    """A run with its refocus PSNR by view and the seconds of its training."""
    spec = Spec(method=method, seed=seed, overrides={}, options={}, **NOBODY)
    scored = [ViewScores(name=name, scores={"psnr": value}) for name, value in views.items()]
    scores = {"psnr": sum(views.values()) / max(len(views), 1), "train_s": seconds}
    return Entry(Path(), spec, "", status, "", Result.model_construct(scores=scores, views=scored))


ONE = [entry("a", seed, {"v0": 30.0 + seed, "v1": 33.0}, 100.0 + 10 * seed) for seed in (0, 1, 2)]
OTHER = [entry("b", seed, {"v1": 30.0, "v0": 30.0}, 80.0 + seed) for seed in (2, 1)]


def test_scores_are_paired_by_view_with_the_seeds_averaged() -> None:
    found = compare([(ONE, OTHER)], "psnr")
    assert found.difference is not None and found.reason == ""
    # Views 0: mean of 30, 31, 32 against 30; view 1: 33 against 30.
    assert (found.difference.pairs, found.difference.seeds) == (2, 2)
    assert found.difference.mean == pytest.approx((1 + 3) / 2)


def test_costs_are_paired_by_seed() -> None:
    """100, 110, 120 against 80, 81, 82: three pairs, of three seeds."""
    third = entry("b", 0, {"v0": 30.0, "v1": 30.0}, 80.0)
    found = compare([(ONE, [*OTHER, third])], "train_s")
    assert found.difference is not None
    assert (found.difference.pairs, found.difference.seeds) == (3, 3)
    assert found.difference.mean == pytest.approx((20 + 29 + 38) / 3)
    assert found.difference.spread == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("other", "column", "reason"),
    [
        ([], "psnr", "failed, or lacks"),
        ([entry("b", 0, {"v0": 1.0, "v1": 1.0}, 1.0, Status.CRASHED)], "psnr", "failed, or lacks"),
        ([entry("b", 0, {"v0": 1.0, "v1": 1.0}, 1.0, Status.CRASHED)], "train_s", "failed, or lacks"),
        ([entry("b", 0, {"v0": 1.0}, 1.0)], "psnr", "same views"),
        ([entry("b", 0, {"v0": 1.0, "v1": 1.0}, 1.0)], "aif_psnr", "failed, or lacks"),
        ([entry("b", 0, {"v0": 1.0, "v1": 1.0}, 1.0)], "peak_mb", "failed, or lacks"),
        (OTHER, "train_s", "same seeds"),
    ],
)
def test_what_cannot_be_paired_says_why(other: list[Entry], column: str, reason: str) -> None:
    found = compare([(ONE, other)], column)
    assert found.difference is None and reason in found.reason and found.verdict == ""


def test_a_gap_among_comparisons_is_not_counted_among_them() -> None:
    """Holm's adjustment is over those that were tested: 1/2 stays twice as large as it is for two of them."""
    gap, tested = compare([(ONE, [])], "psnr"), compare([(ONE, OTHER)], "psnr")
    assert tested.difference is not None and tested.difference.p == 0.5
    p = [one.difference and one.difference.p for one in adjusted([gap, tested, gap])]
    assert p == [None, 0.5, None]
    assert [one.difference and one.difference.p for one in adjusted([tested, gap, tested])] == [1.0, None, 1.0]
