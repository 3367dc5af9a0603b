"""Curves, medians over seeds, the Pareto front and times to reach a score, against their definitions; plots."""

from __future__ import annotations

import itertools
import math
import statistics
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dofbench.core.errors import InputError, Status
from dofbench.core.evidence import ROLE_WORDS, Role
from dofbench.evaluation.comparing.score_curves import (
    Curve,
    curve_of,
    joint_curve,
    levels,
    pareto_front,
    reach,
    reached,
    spans,
    uneven_clocks,
)
from dofbench.reporting.curves import Plot, Series, mean_series, parse_levels
from dofbench.reporting.draw import draw_plot
from dofbench.reporting.timing import reach_text
from dofbench.reporting.view import plot_data

# Few values, so that equal times and equal scores turn up.
TIMES = st.integers(1, 12).map(float)
SCORES = st.integers(-4, 4).map(float)


def by_time(points: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """One score a time, by time."""
    return tuple(sorted(dict(points).items()))


CURVES = st.lists(st.tuples(TIMES, SCORES), min_size=1, max_size=8).map(by_time)


def median_curve(curves) -> tuple[tuple[float, float], ...]:
    return joint_curve(curves, statistics.median)


def series(*curves: tuple[tuple[float, float], ...], status: Status = Status.OK) -> Series:
    """A series with a seed for each curve."""
    runs = tuple(Curve(seed, status, curve, 0) for seed, curve in enumerate(curves))
    return Series(("v",), "fake", "quick", runs, median_curve(curves) if status is Status.OK else (), 0)


# ---- the front ----


def beaten(one: tuple[float, float], other: tuple[float, float], sign: float) -> bool:
    """Whether `other` is as early and as good as `one`, and earlier or better."""
    return other[0] <= one[0] and sign * other[1] >= sign * one[1] and other != one


@given(st.lists(CURVES, min_size=1, max_size=4), st.booleans())
def test_the_front_is_what_nothing_beats(curves, higher_is_better: bool) -> None:
    sign = 1 if higher_is_better else -1
    every = [(time, score, index) for index, curve in enumerate(curves) for time, score in curve]
    expected = {(t, s, i) for t, s, i in every if not any(beaten((t, s), (u, r), sign) for u, r, _ in every)}
    front = pareto_front(curves, higher_is_better=higher_is_better)
    assert {(point.time, point.score, point.series) for point in front} == expected
    assert len(front) == len(expected)
    assert [point.time for point in front] == sorted(point.time for point in front)


@given(st.lists(CURVES, min_size=1, max_size=4))
def test_spans_cover_the_front_and_change_hands(curves) -> None:
    front = pareto_front(curves, higher_is_better=True)
    held = list(spans(front))
    assert all(one != other for (one, *_), (other, *_) in itertools.pairwise(held))
    assert held[0][1] == (front[0].time, front[0].score) and held[-1][2] == (front[-1].time, front[-1].score)


# ---- the median over seeds ----


def joint_times(curves) -> list[float]:
    """When several curves have a point together: whenever each has a score since the point before, and at the end."""
    if len(curves) == 1:
        return [time for time, _ in curves[0]]
    times, since = [], -math.inf
    last = max(time for curve in curves for time, _ in curve)
    while later := [[time for time, _ in curve if time > since] for curve in curves]:
        if not all(later):
            return times if times[-1] == last else [*times, last]
        times.append(since := max(map(min, later)))


@given(st.lists(CURVES, min_size=1, max_size=4))
def test_the_median_is_of_what_was_measured_last(curves) -> None:
    median = median_curve(curves)
    assert [time for time, _ in median] == joint_times(curves)
    for time, score in median:
        known = [max((t, s) for t, s in curve if t <= time)[1] for curve in curves]
        assert score == statistics.median(known)


def test_moments_that_are_nearly_the_same_are_one_point() -> None:
    one, other = ((1.0, 10.0), (5.0, 20.0), (60.0, 30.0)), ((1.01, 12.0), (4.99, 24.0), (20.0, 30.0), (60.02, 36.0))
    assert median_curve([one, other]) == ((1.01, 11.0), (5.0, 22.0), (60.0, 30.0), (60.02, 33.0))


# ---- the mean over scenes ----


@given(st.lists(CURVES, min_size=1, max_size=4))
def test_the_mean_over_scenes_is_of_what_was_measured_last(curves) -> None:
    (found,) = mean_series([(series(curve),) for curve in curves])
    assert [time for time, _ in found.median] == joint_times(curves)
    for time, score in found.median:
        assert score == statistics.fmean(max((t, s) for t, s in curve if t <= time)[1] for curve in curves)
    assert [run.points for run in found.runs] == [found.median] and found.name == "fake quick"


def test_a_variant_that_a_scene_lacks_has_no_mean() -> None:
    whole, failed = series(((1.0, 2.0),)), series(((1.0, 2.0),), status=Status.DIVERGED)
    other = replace(whole, variant=("w",))
    assert [one.variant for one in mean_series([(whole, other), (other, whole)])] == [("v",), ("w",)]
    assert mean_series([(whole,), (other,)]) == mean_series([(whole,), (failed,)]) == []


# ---- time to reach ----


@given(CURVES, SCORES, st.booleans())
def test_reached_is_the_first_scored_moment_and_no_other(curve, level: float, higher_is_better: bool) -> None:
    found = reached(Curve(0, Status.OK, curve, 0), level, higher_is_better=higher_is_better)
    good = [time for time, score in curve if (score >= level if higher_is_better else score <= level)]
    assert found.time == (min(good) if good else None)
    if good:
        earlier = [time for time, _ in curve if time < min(good)]
        assert found.before == (max(earlier) if earlier else 0.0)
        assert found.held == (max(curve)[0] in good)


@given(st.lists(CURVES, min_size=1, max_size=5), SCORES)
def test_a_seed_that_never_gets_there_is_later_than_all(curves, level: float) -> None:
    cell = reach(series(*curves).runs, level, higher_is_better=True)
    times = [min((t for t, s in curve if s >= level), default=math.inf) for curve in curves]
    assert (cell.median, cell.low, cell.high) == (statistics.median(times), min(times), max(times))
    assert cell.count == sum(map(math.isfinite, times)) and cell.seeds == len(curves)
    assert reach_text(cell).startswith("not reached") == math.isinf(cell.median)


def test_what_a_cell_says() -> None:
    one, slow, never = ((1.0, 30.0),), ((9.0, 10.0), (12.0, 30.0)), ((1.0, 10.0),)

    def text(*curves) -> str:
        return reach_text(reach(series(*curves).runs, 30.0, higher_is_better=True))

    assert text(one) == "1.0 s"
    assert text(one, slow, slow) == "12.0 s (1.0 s to 12.0 s)"
    assert text(one, one, never) == "1.0 s (1.0 s to not reached)"
    assert text(one, never, never) == "not reached (1 of 3 seeds did)"
    assert text(never) == "not reached"
    assert text(((1.0, 30.0), (2.0, 29.0))) == "1.0 s, lost again"
    assert text(((1.0, 30.0), (2.0, 29.0)), one) == "1.0 s (1.0 s to 1.0 s), lost again by 1 of 2"


def test_a_run_that_failed_reaches_nothing() -> None:
    cell = reach(series(((1.0, 40.0),), status=Status.DIVERGED).runs, 30.0, higher_is_better=True)
    assert reach_text(cell) == "not reached"


# ---- levels ----


def test_levels_by_the_stated_rule() -> None:
    rising = series(((1.0, 15.0), (9.0, 31.0)))
    # Steps of 0.5 dB: a twentieth of 16 is 0.8
    assert levels(rising.runs, [rising.median], higher_is_better=True) == (23.0, 27.5, 30.0)
    falling = series(((1.0, 0.2), (9.0, 0.006)))
    assert levels(falling.runs, [falling.median], higher_is_better=False) == (0.105, 0.045, 0.02)
    assert levels(series(((1.0, 15.0),)).runs, [((1.0, 15.0),)], higher_is_better=True) == ()


def test_levels_on_the_command_line() -> None:
    assert parse_levels("psnr=28, psnr=30,delta_f=0.01") == {"psnr": (28.0, 30.0), "delta_f": (0.01,)}
    assert parse_levels("") == {}
    for wrong, found in (
        ("psnr", "'psnr'"),
        ("nice=1", "'nice=1'"),
        ("psnr=fast", "a number for psnr"),
        ("psnr=nan", "a number"),
        ("steps=5", "'steps=5'"),
    ):
        with pytest.raises(InputError, match=found):
            parse_levels(wrong)


# ---- plots ----


@pytest.mark.parametrize(
    ("role", "signs", "title", "label"),
    [
        ("development", "†", f"room, refocus-v3, {ROLE_WORDS['development']}", "fake cpu †"),
        ("report", "", f"room, refocus-v3, {ROLE_WORDS['report']}", "fake cpu"),
        (None, "", "room, refocus-v3", "fake cpu"),
    ],
)
def test_a_plot_says_the_role_of_its_scene(role: Role | None, signs: str, title: str, label: str) -> None:
    run = Curve(0, Status.OK, ((1.0, 20.0), (2.0, 21.0)), 0)
    series = Series(("fake",), "fake", "cpu", (run,), (), 0, signs)
    plot = Plot(("room", "sum", "refocus-v3"), "room", "room", role, "psnr", (series,), (), (), False, None)
    (axes,) = draw_plot(plot).axes
    assert axes.get_title() == title and [line.get_label() for line in axes.get_lines()] == [label]
    data = plot_data(plot)
    assert data["board"] == title and data["series"][0]["name"] == label


def series_named(name: str, place: int, *scores: float, status: Status = Status.OK) -> Series:
    """A series of one seed with these scores after 1, 2, ... seconds."""
    points = tuple((float(time), score) for time, score in enumerate(scores, 1))
    return Series((name,), name, "cpu", (Curve(0, status, points, 0),), points if status is Status.OK else (), place)


@pytest.mark.parametrize(("higher", "order"), [(True, ["b", "a", "failed"]), (False, ["a", "b", "failed"])])
def test_the_best_last_score_comes_first_and_failures_last(higher: bool, order: list[str]) -> None:
    found = [
        series_named("failed", 0, 40.0 if higher else 0.0, status=Status.DIVERGED),
        series_named("a", 1, 30.0, 20.0),
        series_named("b", 2, 10.0, 25.0),
    ]
    assert [one.name for one in sorted(found, key=lambda one: one.rank(higher_is_better=higher))] == [
        f"{name} cpu" for name in order
    ]


def test_a_method_looks_the_same_in_every_plot_of_a_report() -> None:
    """dofgaussian, the third variant of the report, alone in one plot and with the others in another."""
    others = (series_named("3dgs", 0, 20.0), series_named("bags", 1, 21.0))
    ours = series_named("dofgaussian", 2, 22.0)
    looks = []
    for shown in ((ours,), (ours, *others)):
        plot = Plot(("room", "sum", "refocus-v3"), "room", "room", None, "psnr", shown, (), (), False, None)
        (axes,) = draw_plot(plot).axes
        lines = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in axes.get_lines()}
        assert len(set(lines.values())) == len(shown)
        looks.append(lines["dofgaussian cpu"])
        data = plot_data(plot)
        assert data["series"][0]["place"] == 2
    assert looks[0] == looks[1]


# ---- the clock ----


def timed(wall: float, cpu: float) -> Any:
    moment = SimpleNamespace(train_s=wall, train_cpu_s=cpu, scores={"psnr": 30.0})
    scores = {"train_s": wall, "train_cpu_s": cpu}
    spec = SimpleNamespace(seed=0)
    return SimpleNamespace(status=Status.OK, scores=scores, spec=spec, result=SimpleNamespace(curve=[moment]))


def test_clocks_that_differ_by_a_fifth_are_uneven() -> None:
    assert not uneven_clocks([timed(60.0, 110.0), timed(60.0, 100.0)])
    assert uneven_clocks([timed(60.0, 110.0), timed(60.0, 80.0)])
    assert not uneven_clocks([timed(60.0, 110.0), timed(0.5, 0.1)])  # too short to tell
    assert not uneven_clocks([timed(60.0, 110.0), timed(60.0, 0.0)])  # an old result without processor time
    assert not uneven_clocks([])


def test_a_curve_over_processor_time() -> None:
    assert curve_of(timed(60.0, 110.0), "psnr").points == ((60.0, 30.0),)
    assert curve_of(timed(60.0, 110.0), "psnr", processor=True).points == ((110.0, 30.0),)
