"""Plots against training time: what their titles and legends say."""

from __future__ import annotations

import pytest

from dofbench.core.errors import Status
from dofbench.core.evidence import Role
from dofbench.reporting.curves import _figure
from dofbench.reporting.html.plot_data import plot_data
from dofbench.reporting.plots import Plot
from dofbench.reporting.series import Run, Series


@pytest.mark.parametrize(
    ("role", "signs", "title", "label"),
    [
        ("development", "†", "room, refocus-v3, development scene", "fake cpu †"),
        ("report", "", "room, refocus-v3, report scene", "fake cpu"),
        (None, "", "room, refocus-v3", "fake cpu"),
    ],
)
def test_a_plot_says_the_role_of_its_scene(role: Role | None, signs: str, title: str, label: str) -> None:
    run = Run(0, Status.OK, ((1.0, 20.0), (2.0, 21.0)), 0)
    series = Series(("fake",), "fake", "cpu", (run,), (), 0, signs)
    plot = Plot(("room", "sum", "refocus-v3"), "room", "room", role, "psnr", (series,), (), (), False, None)
    (axes,) = _figure(plot).axes
    assert axes.get_title() == title and [line.get_label() for line in axes.get_lines()] == [label]
    (data,) = plot_data([plot])
    assert data["board"] == title and data["series"][0]["name"] == label


def series_named(name: str, place: int, *scores: float, status: Status = Status.OK) -> Series:
    """A series of one seed with these scores after 1, 2, ... seconds."""
    points = tuple((float(time), score) for time, score in enumerate(scores, 1))
    return Series((name,), name, "cpu", (Run(0, status, points, 0),), points if status is Status.OK else (), place)


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
        (axes,) = _figure(plot).axes
        lines = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in axes.get_lines()}
        assert len(set(lines.values())) == len(shown)
        looks.append(lines["dofgaussian cpu"])
        (data,) = plot_data([plot])
        assert data["series"][0]["place"] == 2
    assert looks[0] == looks[1]
