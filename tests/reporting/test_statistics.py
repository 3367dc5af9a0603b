"""Paired differences: what is paired, tests and intervals against scipy and by hand, what a design decides, words."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tolerances import FLIPPED_AT_RANDOM

from dofbench.core.errors import Status
from dofbench.evaluation.comparing.design import design_words, smallest_found, undecided, units_for
from dofbench.evaluation.comparing.means import Statistic
from dofbench.evaluation.comparing.paired import (
    Compared,
    Difference,
    adjusted,
    compare,
    grouped_difference,
    holm,
    sign_flip,
)
from dofbench.evaluation.comparing.pairwise import pairwise
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.result import Result, Spec, ViewScores
from dofbench.reporting.boards import Line
from dofbench.reporting.overview import Verdict, verdicts
from dofbench.reporting.render import markdown
from dofbench.reporting.tables import Heading, Section, Table, difference

# Whole numbers and powers of two, whose sums aren't rounded: what ties, ties in every order and unit.
WHOLE = st.lists(st.integers(-40, 40), min_size=1, max_size=9)


@given(WHOLE, st.integers(1, 8), st.sampled_from([2.0**-7, 0.5, 4.0, 2.0**20]))
def test_p_knows_no_order_no_unit_and_no_direction(differences: list[int], turn: int, scale: float) -> None:
    values = np.array(differences, np.float64)
    p = sign_flip(values)
    assert p == sign_flip(-values) == sign_flip(np.roll(values, turn)) == sign_flip(np.sort(values))
    assert p == sign_flip(values * scale)
    assert 2.0 ** (1 - len(values)) <= p <= 1


@given(WHOLE)
def test_p_of_whole_numbers_is_exactly_the_share_of_the_choices_that_are_as_far(differences: list[int]) -> None:
    sums = [
        abs(sum(sign * one for sign, one in zip(signs, differences, strict=True)))
        for signs in itertools.product((1, -1), repeat=len(differences))
    ]
    assert sign_flip(np.array(differences, np.float64)) == sum(one >= abs(sum(differences)) for one in sums) / len(sums)


@pytest.mark.parametrize("count", [12, 40])
def test_p_against_scipy(count: int) -> None:
    differences = np.random.default_rng(count).normal(0.3, 1.0, count)
    expected = stats.permutation_test(
        (differences,), np.sum, permutation_type="samples", n_resamples=100_000, rng=np.random.default_rng(1)
    ).pvalue
    assert sign_flip(differences) == pytest.approx(expected, abs=FLIPPED_AT_RANDOM)


def test_without_a_difference_p_is_as_often_small_as_it_says() -> None:
    """Of scores with skewed noise, a few views each: the test must not claim more than it may."""
    random = np.random.default_rng(0)
    found = [sign_flip(random.laplace(0, 1, 8) * random.choice([0.1, 1, 5], 8)) for _ in range(2000)]
    for level in (0.05, 0.2, 0.5):
        assert np.mean(np.array(found) <= level) <= level + 0.02


def paired_difference(pairs: list[tuple[float, float]]) -> Difference:
    """Of (value, reference) pairs of one scene and one training each."""
    values = np.array(pairs, dtype=float).reshape(-1, 2)
    return grouped_difference([(values[None, :, 0], values[None, :, 1])])


def test_a_difference_by_hand() -> None:
    """2, 1 and 0.5: 1.167 with a standard error of 0.441, and 4.303 as Student's t of two degrees of freedom."""
    found = paired_difference([(3.0, 1.0), (4.0, 3.0), (5.0, 4.5)])
    assert (found.pairs, found.units, found.above, found.below, found.p) == (3, 3, 3, 0, None)
    assert (found.mean, found.spread) == pytest.approx((3.5 / 3, np.std([2, 1, 0.5], ddof=1)))
    assert (found.low, found.high) == pytest.approx((1.16667 - 1.89733, 1.16667 + 1.89733), abs=1e-4)
    seeds = grouped_difference([(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.0, 1.0]]))])
    assert (seeds.pairs, seeds.mean, seeds.seeds) == (2, 2.0, 1)


def test_every_scene_weighs_the_same() -> None:
    few, many = (np.full((1, 2), 3.0), np.zeros((1, 2))), (np.full((1, 8), 1.0), np.zeros((1, 8)))
    found = grouped_difference([few, many])
    assert found.mean == pytest.approx(2.0) and (found.pairs, found.groups, found.units, found.above) == (10, 2, 2, 10)


@given(st.lists(st.lists(st.floats(-50, 50), min_size=1, max_size=4), min_size=3, max_size=7))
def test_over_scenes_interval_and_p_are_those_of_scipy_of_the_scenes_means(scenes: list[list[float]]) -> None:
    """How many views a scene has, and how they scatter, is no matter."""
    groups = [(np.array([views]), np.zeros((1, len(views)))) for views in scenes]
    means = np.array([np.mean(views) for views in scenes])
    found = grouped_difference(groups)
    if means.std() < 1e-6:  # equal but for rounding: scipy's t would be of noise
        return
    expected = stats.ttest_1samp(means, 0.0)
    assert found.p == pytest.approx(expected.pvalue, rel=1e-6, abs=1e-12)
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval(0.95)), rel=1e-6, abs=1e-6)


def test_p_of_one_scene_is_that_of_the_flipped_signs() -> None:
    differences = [0.5, 1.0, 0.75, 1.25, 0.25, 2.0, -0.125]
    found = paired_difference([(one, 0.0) for one in differences])
    assert found.p == sign_flip(np.array(differences)) and (found.above, found.below) == (6, 1)


@pytest.mark.parametrize(
    ("views", "scenes", "decides"), [(1, 1, False), (5, 1, False), (6, 1, True), (40, 2, False), (9, 3, True)]
)
def test_p_and_words_say_alike_what_a_design_can_decide(views: int, scenes: int, decides: bool) -> None:
    values = np.random.default_rng(views).normal(1.0, 0.3, views)
    found = grouped_difference([(part[None], np.zeros((1, len(part)))) for part in np.array_split(values, scenes)])
    assert (found.p is not None) is decides and bool(undecided(views, scenes)) is not decides
    words = design_words(views, scenes, [0.5])
    assert ("can't decide" in words) is not decides


def test_three_views_of_one_scene_are_told_how_many_would_do() -> None:
    assert undecided(3, 1) == "3 test views of one scene can't decide (p ≥ 0.25 whatever happens): 6 would, or 3 scenes"


@pytest.mark.parametrize("units", [2, 3, 6, 9, 30])
def test_the_smallest_difference_found_is_found_in_four_cases_of_five(units: int) -> None:
    """By drawing: at that size four of five tests find it."""
    smallest = smallest_found(0.7, units)
    drawn = np.random.default_rng(units).normal(smallest, 0.7, (20_000, units))
    assert np.mean(stats.ttest_1samp(drawn, 0.0, axis=1).pvalue < 0.05) == pytest.approx(0.8, abs=0.015)


@given(st.floats(0.05, 3.0), st.floats(0.1, 3.0))
def test_as_many_units_as_are_asked_for_find_the_difference_and_one_fewer_does_not(
    scatter: float, difference: float
) -> None:
    count = units_for(scatter, difference)
    assert count is not None
    assert smallest_found(scatter, count) <= difference * (1 + 1e-6)
    assert count == 2 or smallest_found(scatter, count - 1) > difference * (1 - 1e-6)


@pytest.mark.slow
def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        found = grouped_difference([(random.normal(0.5, 1.0, (1, 20)), np.zeros((1, 20)))])
        inside += found.low <= 0.5 <= found.high
    assert 0.88 <= inside / 200 <= 0.99


def test_seeds_that_disagree_widen_the_interval() -> None:
    random = np.random.default_rng(2)
    views = random.normal(0.5, 0.05, 12)
    same = grouped_difference([(np.stack([views] * 3), np.zeros((3, 12)))])
    unsure = grouped_difference([(np.stack([views - 1, views, views + 1]), np.zeros((3, 12)))])
    assert unsure.mean == pytest.approx(same.mean) and unsure.p == same.p
    assert same.telling and not unsure.telling and unsure.low < 0 < unsure.high
    assert Compared("psnr", same).verdict == "better" and Compared("psnr", unsure).verdict == ""
    # The seeds' own standard error is 1 / √3, of two degrees of freedom: all but alone in the variance.
    assert unsure.high - unsure.mean == pytest.approx(stats.t.ppf(0.975, 2) / math.sqrt(3), rel=0.02)


def test_what_cannot_be_tested() -> None:
    assert paired_difference([(2.0, 1.0)]) == Difference(1, 1.0, None, None, above=1)
    assert paired_difference([(2.0, 2.0), (3.0, 3.0)]) == Difference(2, 0.0, 0.0, None)
    assert math.isnan(paired_difference([(math.nan, 1.0), (2.0, 1.0)]).mean)
    infinite = paired_difference([(math.inf, 1.0), (2.0, 1.0)])
    assert infinite.mean == math.inf and infinite.p is None
    assert math.isnan(paired_difference([(math.inf, math.inf), (2.0, 1.0)]).mean)
    same = np.array([[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])
    assert grouped_difference([(same, same)]) == Difference(3, 0.0, 0.0, None, seeds=2)
    with pytest.raises(ValueError, match="at least one pair"):
        paired_difference([])
    with pytest.raises(ValueError, match="found"):
        grouped_difference([(np.zeros((1, 2)), np.zeros((1, 3)))])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([None]) == [None] and holm([]) == []


def shown(found: Difference, column: str) -> str:
    """The difference as Markdown shows it."""
    table = Table("", (Heading("a"),), ((difference(Compared(column, found)),),), names=0)
    return markdown("ablation", page=Section("", tables=(table,))).strip().splitlines()[-1].strip("| ")


@pytest.mark.parametrize(
    ("column", "mean", "p", "text"),
    [
        ("psnr", 0.314, 0.003, "+0.31 [+0.26, +0.36], 7 of 8, p = 0.003, **better**"),
        ("psnr", -0.314, 0.0002, "-0.31 [-0.36, -0.26], 7 of 8, p < 0.001, **worse**"),
        ("psnr", 0.314, 0.05, "+0.31 [+0.26, +0.36], 7 of 8, p = 0.050"),
        ("delta_a", -0.314, 0.01, "-0.314 [-0.364, -0.264], 1 of 8, p = 0.010, **better**"),
        ("delta_a", 0.314, 0.01, "+0.314 [+0.264, +0.364], 1 of 8, p = 0.010, **worse**"),
        ("psnr", 0.024, 0.01, "+0.02 [-0.03, +0.07], 7 of 8, p = 0.010"),
        ("train_s", 3.0, 0.01, "+3.0 [+3.0, +3.0], p = 0.010, more"),
    ],
)
def test_a_verdict_stands_only_where_the_test_bears_it(column: str, mean: float, p: float, text: str) -> None:
    found = Difference(8, mean, 0.1, p, mean - 0.05, mean + 0.05, seeds=3, above=7, below=1)
    assert shown(found, column) == text


def test_one_training_and_few_views_are_said() -> None:
    assert shown(Difference(8, 0.004, 0.1, 0.01, 0.003, 0.005, 3), "psnr").endswith("p = 0.010")  # shown as zero
    once = Difference(8, 1.0, 0.1, 0.01, 0.9, 1.1, seeds=1)
    assert shown(once, "psnr").endswith("p = 0.010, **better** (one seed)")
    assert shown(Difference(3, 1.0, 0.1, None, 0.5, 1.5, above=3), "psnr") == "+1.00 [+0.50, +1.50], 3 of 3"
    assert shown(Difference(8, math.nan, None, None), "psnr") == "+nan, 0 of 8"


# ---- pairs of runs ----

NOBODY = dict.fromkeys(("preset", "budget", "dataset", "dataset_checksum", "protocol", "device", "code"), "x")


def entry(method: str, seed: int, views: dict[str, float], seconds: float, status: Status = Status.OK) -> Entry:
    """A run with its refocus PSNR by view and the seconds of its training."""
    spec = Spec(method=method, seed=seed, overrides={}, options={}, **NOBODY)
    scored = [ViewScores(name=name, scores={"psnr": value}) for name, value in views.items()]
    scores = {"psnr": sum(views.values()) / max(len(views), 1), "train_s": seconds}
    return Entry(Path(), spec, "", status, "", Result.model_construct(scores=scores, views=scored, lens=[]))


ONE = [entry("a", seed, {"v0": 30.0 + seed, "v1": 33.0}, 100.0 + 10 * seed) for seed in (0, 1, 2)]
OTHER = [entry("b", seed, {"v1": 30.0, "v0": 30.0}, 80.0 + seed) for seed in (2, 1)]


def test_scores_are_paired_by_view_with_the_seeds_averaged() -> None:
    found = compare([(ONE, OTHER)], "psnr")
    assert found.difference is not None and found.reason == ""
    # Views 0: mean of 30, 31, 32 against 30; view 1: 33 against 30.
    assert (found.difference.pairs, found.difference.seeds) == (2, 2)
    assert found.difference.mean == pytest.approx((1 + 3) / 2)


@pytest.mark.parametrize("views", [8, 20])  # all signs, and random ones
@pytest.mark.parametrize("scenes", [1, 3])
def test_without_the_test_everything_but_p_is_the_same(views: int, scenes: int) -> None:
    random = np.random.default_rng(0)
    groups = [(random.normal(1.0, 1.0, (2, views)), random.normal(0.0, 1.0, (3, views))) for _ in range(scenes)]
    tested, untested = grouped_difference(groups), grouped_difference(groups, test=False)
    assert tested.p is not None and untested == replace(tested, p=None)


def test_the_interval_is_students() -> None:
    """Of one group and of several, against scipy's own."""
    values = np.random.default_rng(1).normal(0.3, 1.0, (3, 9))
    one = grouped_difference([(values[:1], np.zeros((1, 9)))])
    low, high = stats.t.interval(0.95, 8, values[0].mean(), stats.sem(values[0]))
    assert (one.low, one.high) == pytest.approx((low, high), rel=1e-12)
    several = grouped_difference([(row[None], np.zeros((1, 9))) for row in values])
    assert several.p == pytest.approx(stats.ttest_1samp(values.mean(axis=1), 0.0).pvalue, rel=1e-12)


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
    """Holm's adjustment is over those that were tested: 1/64 stays twice as large as it is for two of them."""
    six, none = (
        [entry(method, 0, {f"v{n}": value for n in range(6)}, 1.0)] for method, value in (("a", 31.0), ("b", 30.0))
    )
    gap, tested = compare([(six, [])], "psnr"), compare([(six, none)], "psnr")
    assert tested.difference is not None and tested.difference.p == 2 / 64
    p = [one.difference and one.difference.p for one in adjusted([gap, tested, gap])]
    assert p == [None, 2 / 64, None]
    assert [one.difference and one.difference.p for one in adjusted([tested, gap, tested])] == [4 / 64, None, 4 / 64]


def test_a_pair_has_one_p() -> None:
    """In the first PSNR that most pairs have; all other scores have their intervals alone."""
    random = np.random.default_rng(3)

    def of(method: str, *columns: str) -> list[Entry]:
        scored = [
            ViewScores(name=f"v{n}", scores={column: 30 + random.normal() for column in columns}) for n in range(8)
        ]
        return [replace(entry(method, 0, {}, 1.0), result=Result.model_construct(scores={}, views=scored, lens=[]))]

    runs = {
        "a": of("a", "psnr", "ssim", "aif_psnr"),
        "b": of("b", "psnr", "ssim", "aif_psnr"),
        "c": of("c", "aif_psnr"),
    }
    board = {made[0].variant: made for made in runs.values()}
    with_c = pairwise([board])
    assert {pair.tested for pair in with_c} == {"aif_psnr"}
    without_c = pairwise([{key: made for key, made in board.items() if made != runs["c"]}])
    assert {pair.tested for pair in without_c} == {"psnr"}
    for pair in (*with_c, *without_c):
        tested = [column for column, one in pair.compared.items() if one.difference and one.difference.p is not None]
        assert tested == [pair.tested]
        assert all(one.difference is None or one.difference.low is not None for one in pair.compared.values())


# ---- which is best ----

A, B, C = (entry(method, 0, {}, 1.0).variant for method in "abc")
VIEWS = [30.0, 31.0, 32.0, 28.0, 29.5, 33.0, 30.5, 31.5]


def run(method: str, views: list[float], seed: int = 0, status: Status = Status.OK) -> Entry:
    return entry(method, seed, {f"v{index}": value for index, value in enumerate(views)}, 1.0, status)


def lines(entries: list[Entry]) -> dict[tuple[str, ...], Line]:
    """Their means over seeds."""
    found = {}
    for variant in dict.fromkeys(one.variant for one in entries):
        values = [one.scores["psnr"] for one in entries if one.variant == variant]
        cells = {"psnr": Statistic(sum(values) / len(values)), "aif_psnr": Statistic(None, reason="not asked")}
        found[variant] = Line(variant[0], "", "", cells)
    return found


def verdict(found: dict[tuple[str, ...], Line], *boards: list[Entry]) -> Verdict:
    """The only verdict on one table."""
    runs = [{variant: [e for e in entries if e.variant == variant] for variant in found} for entries in boards]
    (told,) = verdicts(found, runs, pairwise([{key: own for key, own in one.items() if own} for one in runs]))
    return told


def test_the_lead_is_tested_view_by_view() -> None:
    ahead = [0.9, 1.1, 1.0, 0.8, 1.2, 1.0, 0.95, 1.05]
    entries = [run("b", VIEWS, seed) for seed in range(3)]
    entries += [run("a", [v + d for v, d in zip(VIEWS, ahead, strict=True)], seed) for seed in range(3)]
    found = verdict(lines(entries), entries)
    assert (found.best, found.second, found.sure.kind) == (A, B, "sure") and found.ahead == pytest.approx(1.0)
    # All eight differences have one sign: of 2 ** 8 choices of signs, two are as extreme.
    assert found.sure.text == "over 8 test views, 3 seeds; +1.00" and found.sure.test.wins == "8 of 8"
    assert (found.sure.test.p, found.sure.test.verdict) == (f"p = {2 / 2**8:.3f}", "better")


@pytest.mark.parametrize(
    ("one", "other", "status", "kind"),
    [
        (VIEWS, [v + d for v, d in zip(VIEWS, (3, -2, 1, -1, 2, -1, 0.5, -0.5), strict=True)], Status.OK, "unsure"),
        ([30.0, 33.0, 29.0], [29.0, 31.0, 28.0], Status.OK, "untested"),  # too few views
        (VIEWS, [v - 1 for v in VIEWS], Status.CRASHED, "untested"),
    ],
)
def test_a_lead_that_the_test_does_not_support_is_not_sure(
    one: list[float], other: list[float], status: Status, kind: str
) -> None:
    entries = [run("a", one), run("b", other, status=status)]
    found = verdict(lines(entries), entries)
    assert found.best == (A if sum(one) > sum(other) else B) and found.sure.kind == kind
    assert status is not Status.OK or "one seed" in found.sure.text
    assert ("3 test views of one scene can't decide" in found.sure.below) is (len(one) == 3)


def test_a_gap_is_no_rival() -> None:
    entries = [run("a", [20.0]), run("b", [30.0]), run("c", [29.5])]
    found = lines(entries)
    found[A] = Line("a", "", "", {"psnr": Statistic(None, failure="crashed"), "aif_psnr": Statistic(None)})
    told = verdict(found, entries)
    assert (told.best, told.second) == (B, C) and told.ahead == pytest.approx(0.5)
    found[C] = Line("c", "", "", {"psnr": Statistic(float("nan")), "aif_psnr": Statistic(None)})
    told = verdict(found, entries)
    assert (told.best, told.second, told.sure.text) == (B, None, "nothing to compare it with")


def test_a_mean_is_tested_over_scenes() -> None:
    """Three views are too few on one scene, six of two scenes tell nothing of scenes; three scenes are enough."""
    one = [run("a", [30.0, 33.0, 29.0]), run("b", [29.0, 31.9, 28.0])]
    two = [run("a", [20.0, 23.0, 19.0]), run("b", [19.1, 21.9, 18.0])]
    three = [run("a", [25.0, 24.0]), run("b", [24.0, 22.9])]
    found = verdict(lines(one + two + three), one, two, three)
    assert (found.best, found.second, found.sure.kind) == (A, B, "sure")
    assert found.sure.text.startswith("over 8 test views of 3 scenes")
    few = verdict(lines(one + two), one, two)
    assert few.sure.kind == "untested" and "2 scenes can't decide" in few.sure.below
    assert verdict(lines(one), one).sure.kind == "untested"
    assert verdict(lines(one), one, two[:1]).sure.kind == "untested"  # one of them wasn't run on a scene


def test_every_thing_to_be_best_at_has_a_verdict() -> None:
    def line(name: str, **scores: float) -> Line:
        return Line(name, "", "", {column: Statistic(scores.get(column)) for column in ("psnr", "aif_psnr", *scores)})

    table = {A: line("a", psnr=30.0, aif_psnr=24.0), B: line("b", aif_psnr=25.0), C: line("c", psnr=29.0)}
    told = [(one.column, one.best, one.second) for one in verdicts(table, [{}], [])]
    assert told == [("psnr", A, C), ("aif_psnr", B, A)]
    assert [one.column for one in verdicts({A: line("a", photo_psnr=20.0, across_psnr=21.0)}, [], [])] == ["photo_psnr"]
    assert [one.column for one in verdicts({A: line("a", across_psnr=21.0)}, [], [])] == ["across_psnr"]
    assert list(verdicts({A: line("a")}, [], [])) == []
