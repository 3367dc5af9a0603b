"""Paired differences: the sign-flip test against every choice of signs, scipy and by hand; intervals; words."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tolerances import FLIPPED_AT_RANDOM, FLOAT64_VALUE

from dofbench.reporting.differences import Compared, adjusted
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.html.html_blocks import table_html
from dofbench.reporting.markdown_writer import markdown_page
from dofbench.reporting.paired import Difference, grouped_difference, holm, sign_flip
from dofbench.reporting.table_cells import difference
from dofbench.reporting.view import Document, Heading, Table

FEW = st.lists(st.floats(-10, 10), min_size=1, max_size=9)


@given(FEW)
def test_p_is_the_share_of_all_choices_of_signs(differences: list[float]) -> None:
    found = abs(math.fsum(differences))
    slack = 10 * FLOAT64_VALUE * math.fsum(map(abs, differences))  # of the order of a sum; a tie is as far
    choices = [
        abs(math.fsum(sign * one for sign, one in zip(signs, differences, strict=True)))
        for signs in itertools.product((1, -1), repeat=len(differences))
    ]
    least = sum(one > found + slack for one in choices) / len(choices)
    most = sum(one >= found - slack for one in choices) / len(choices)
    assert least <= sign_flip(np.array(differences)) <= most


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


@pytest.mark.parametrize("count", [1, 2, 5, 6, 10])
def test_p_where_all_say_the_same(count: int) -> None:
    assert sign_flip(np.linspace(1, 2, count)) == 2.0 ** (1 - count)


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
    found = paired_difference([(3.0, 1.0), (4.0, 3.0), (5.0, 4.5)])
    assert found.pairs == 3 and found.mean == pytest.approx(3.5 / 3) and found.low is None and found.p == 0.25
    assert found.spread == pytest.approx(np.std([2, 1, 0.5], ddof=1))
    seeds = grouped_difference([(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.0, 1.0]]))])
    assert (seeds.pairs, seeds.mean, seeds.seeds) == (2, 2.0, 1)


def test_every_group_weighs_the_same() -> None:
    few, many = (np.full((1, 2), 3.0), np.zeros((1, 2))), (np.full((1, 8), 1.0), np.zeros((1, 8)))
    found = grouped_difference([few, many])
    assert found.mean == pytest.approx(2.0) and found.pairs == 10
    assert found.p == 2.0**-9 and found.low == pytest.approx(2.0) == found.high


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


def test_what_cannot_be_tested() -> None:
    assert paired_difference([(2.0, 1.0)]) == Difference(1, 1.0, None, 1.0)
    assert paired_difference([(2.0, 2.0), (3.0, 3.0)]) == Difference(2, 0.0, 0.0, None)
    assert math.isnan(paired_difference([(math.nan, 1.0), (2.0, 1.0)]).mean)
    infinite = paired_difference([(math.inf, 1.0), (2.0, 1.0)])
    assert infinite.mean == math.inf and infinite.p is None
    assert math.isnan(paired_difference([(math.inf, math.inf), (2.0, 1.0)]).mean)
    with pytest.raises(ValueError, match="at least one pair"):
        paired_difference([])
    with pytest.raises(ValueError, match="found"):
        grouped_difference([(np.zeros((1, 2)), np.zeros((1, 3)))])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([None]) == [None] and holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_lies_between_the_plain_and_bonferroni_s(values: list[float]) -> None:
    adjusted = holm(values)
    assert all(p <= a <= min(1, p * len(values)) + FLOAT64_VALUE for p, a in zip(values, adjusted, strict=True))
    order = np.argsort(values, kind="stable")
    assert list(np.array(adjusted)[order]) == sorted(adjusted)


def words(text: str) -> str:
    return re.sub(r"[\s*,]", "", text.replace("&lt;", "<"))


def shown(found: Difference, column: str) -> tuple[str, str]:
    """The difference as Markdown and as HTML show it."""
    table = Table("", (Heading("a"),), ((difference(Compared(column, found)),),), names=0)
    (_, _, row) = markdown_page(Document("", "", (table,))).strip().splitlines()[-3:]
    html = table_html(table, Footnotes())
    return row.strip("| "), re.sub("<[^>]*>", " ", html.partition("<tbody>")[2])


@pytest.mark.parametrize(
    ("column", "mean", "p", "text"),
    [
        ("psnr", 0.314, 0.003, "+0.31 [+0.26, +0.36], p = 0.003, **better**"),
        ("psnr", -0.314, 0.0002, "-0.31 [-0.36, -0.26], p < 0.001, **worse**"),
        ("psnr", 0.314, 0.05, "+0.31 [+0.26, +0.36], p = 0.050"),
        ("delta_a", -0.314, 0.01, "-0.314 [-0.364, -0.264], p = 0.010, **better**"),
        ("delta_a", 0.314, 0.01, "+0.314 [+0.264, +0.364], p = 0.010, **worse**"),
        ("psnr", 0.024, 0.01, "+0.02 [-0.03, +0.07], p = 0.010"),
        ("train_s", 3.0, 0.01, "+3.0 [+3.0, +3.0], p = 0.010, more"),
    ],
)
def test_a_verdict_stands_only_where_the_test_bears_it(column: str, mean: float, p: float, text: str) -> None:
    known = Difference(8, mean, 0.1, p, mean - 0.05, mean + 0.05, seeds=3)
    markdown, html = shown(known, column)
    # The page has the same, the p on a line of its own.
    assert markdown == text and words(html) == words(text)


def test_what_cannot_be_seen_is_no_better() -> None:
    assert shown(Difference(8, 0.004, 0.1, 0.01, 0.003, 0.005, 3), "psnr")[0].endswith("p = 0.010")


def test_one_training_and_few_views_are_said() -> None:
    once = Difference(8, 1.0, 0.1, 0.01, 0.9, 1.1, seeds=1)
    assert shown(once, "psnr")[0].endswith("p = 0.010, **better** (one seed)")
    assert shown(Difference(3, 1.0, 0.1, 0.25), "psnr")[0] == "+1.00, p = 0.250"
    assert shown(Difference(8, math.nan, None, None), "psnr")[0] == "+nan"


def test_comparisons_of_a_column_are_judged_by_their_adjusted_p() -> None:
    """Holm by hand: of three, the least times 3, the next times 2, the last as it is, and none below its predecessor.
    Two at 0.03 would each be significant alone, and neither is beside the other."""
    compared = [Compared("psnr", Difference(9, 1.0, 0.5, p, low=0.2, high=1.8)) for p in (0.04, 0.011, 0.02, None)] + [
        Compared("psnr", None, "no views")
    ]
    assert [one.verdict for one in compared] == ["better", "better", "better", "", ""]
    found = adjusted(compared)
    assert [one.difference.p if one.difference else None for one in found] == [
        pytest.approx(0.04),
        pytest.approx(0.033),
        pytest.approx(0.04),
        None,
        None,
    ]
    pair = adjusted([Compared("psnr", Difference(9, 1.0, 0.5, 0.03, low=0.2, high=1.8))] * 2)
    assert [one.verdict for one in pair] == ["", ""]


def test_what_is_equal_everywhere_has_its_seeds_too() -> None:
    values = np.array([[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])
    found = grouped_difference([(values, values)])
    assert (found.mean, found.spread, found.p, found.seeds) == (0.0, 0.0, None, 2)
