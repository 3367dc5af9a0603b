"""Learned apertures against 1 / f-number, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.evaluation.metrics.exif_errors import ExifIntervals, exif_errors, exif_intervals


def test_by_hand() -> None:
    # Aperture x f-number: 9, 10, 11, 15 at f/5, median 10.5, deviations 1.5, 0.5, 0.5, 4.5, median 1.0;
    # 11, 12, 24 at f/10, median 12, deviations 1, 0, 12, median 1.
    found = exif_errors([(9 / 5, 5), (2, 5), (11 / 5, 5), (3, 5), (1.1, 10), (1.2, 10), (2.4, 10)])
    assert found.spread == pytest.approx(100 * 1.4826 * (4 * 1.0 / 10.5 + 3 * 1.0 / 12) / 7, abs=FLOAT64_VALUE)
    assert found.ratio == pytest.approx(100 * (12 / 10.5 - 1), abs=FLOAT64_VALUE)
    deviation = (20.75 / 3) ** 0.5  # of 9, 10, 11, 15: mean 11.25, squares 5.0625 + 1.5625 + 0.0625 + 14.0625
    other = (314 / 3 / 2) ** 0.5  # of 11, 12, 24: mean 47 / 3, squares (196 + 121 + 625) / 9
    assert found.deviation == pytest.approx(100 * (4 * deviation / 11.25 + 3 * other / (47 / 3)) / 7, abs=FLOAT64_VALUE)
    assert found.no_spread == found.no_ratio == ""


def test_the_ratio_is_the_largest_between_any_two() -> None:
    groups = [(10.0, 5), (20.0, 8), (16.0, 10)]  # products 50, 160, 160
    found = exif_errors([(aperture * share, number) for aperture, number in groups for share in (0.9, 1, 1.1)])
    assert found.ratio == pytest.approx(220, rel=FLOAT64_VALUE)


@given(st.lists(st.floats(1, 1000), min_size=5, max_size=12, unique=True), st.floats(0.01, 100))
def test_the_scene_unit_doesnt_count(apertures: list[float], unit: float) -> None:
    estimates = [(aperture, (4, 8)[index % 2]) for index, aperture in enumerate(apertures)]
    one, other = exif_errors(estimates), exif_errors([(unit * aperture, number) for aperture, number in estimates])
    for name in ("spread", "ratio", "deviation"):
        assert getattr(one, name) == (
            None
            if getattr(other, name) is None
            else pytest.approx(getattr(other, name), rel=FLOAT64_VALUE, abs=FLOAT64_VALUE)
        )


@pytest.mark.parametrize(
    ("estimates", "spread", "ratio"),
    [
        ([], "no learned aperture", "no learned aperture"),
        ([(1, 5), (2, 5)], "no f-number has 3", "no f-number has 3"),
        ([(1, 5), (2, 5), (3, 5)], "", "fewer than two f-numbers"),
        ([(1, 5), (2, 5), (3, 5), (1, 8), (2, 8)], "", "fewer than two f-numbers"),
        # Apertures shared by the views of an f-number: the spread is meaningless, the ratio is not.
        ([(3, 5)] * 3 + [(2.5, 10)] * 3, "all views of an f-number share one aperture", ""),
        # Apertures shared by EXIF's f-numbers: both are meaningless.
        ([(4, 5)] * 3 + [(2, 10)] * 3, "all views of an f-number share one aperture", "tied by EXIF"),
        (
            [(4 * (1 + 1e-12), 5), (4, 5), (4, 5)] + [(2, 10)] * 3,
            "all views of an f-number share one aperture",
            "tied by EXIF",
        ),
        # The same with the rounding errors of a training in float32.
        (
            [(float(np.float32(72.7) / np.float32(number)), number) for number in (14, 5, 6.3) for _ in range(3)],
            "all views of an f-number share one aperture",
            "tied by EXIF",
        ),
        # Half of the apertures still have their initial value.
        ([(4, 5)] * 4 + [(5, 5), (6, 5), (7, 5)], "or half of them", "fewer than two f-numbers"),
        ([(0, 5), (0, 5), (1, 5)], "median aperture is zero", "fewer than two f-numbers"),
    ],
)
def test_what_says_nothing_is_left_out_with_the_reason(estimates, spread: str, ratio: str) -> None:
    found = exif_errors(estimates)
    assert (found.spread is None) is bool(spread) and spread in found.no_spread
    assert (found.ratio is None) is bool(ratio) and ratio in found.no_ratio
    assert (found.deviation is None) is (found.spread is None)


def drawn(seed: int, views: int, sigma: float = 0.1) -> list[tuple[float, float]]:
    """Apertures of a lens whose aperture x f-number is 10, off at random, of two f-numbers in turn."""
    random = np.random.default_rng(seed)
    numbers = [(2.8, 5.6)[index % 2] for index in range(views)]
    return [(10 / number * random.normal(1, sigma), number) for number in numbers]


def test_intervals_hold_the_scores_and_narrow_with_more_views() -> None:
    few, many = (exif_intervals(drawn(3, views)) for views in (12, 192))
    found = exif_errors(drawn(3, 192))
    assert many.spread[0] < found.spread < many.spread[1]
    for name in ("spread", "product"):
        widths = [np.ptp(getattr(one, name)) for one in (few, many)]
        assert widths[1] < widths[0] / 2, "a sixteenth of the views: about a quarter"
    assert exif_intervals(drawn(3, 12)) == few, "by a fixed seed"


def test_the_interval_of_the_product_holds_the_truth_as_often_as_it_says() -> None:
    held = [low <= 10 <= high for seed in range(60) for low, high in [exif_intervals(drawn(seed, 24)).product]]
    assert np.mean(held) > 0.85


def test_what_has_no_score_has_no_interval() -> None:
    assert exif_intervals([]) == ExifIntervals(None, None, None)
    one = exif_intervals([(1.0, 5.0), (1.2, 5.0), (1.3, 5.0)])
    assert one.spread is not None and one.ratio is None and one.product[0] >= 5
