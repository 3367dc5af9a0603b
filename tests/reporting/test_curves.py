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
    series = Series(("fake",), "fake", "cpu", (run,), (), signs)
    plot = Plot(("room", "sum", "refocus-v3"), "room", "room", role, "psnr", (series,), (), (), False, None)
    (axes,) = _figure(plot).axes
    assert axes.get_title() == title and [line.get_label() for line in axes.get_lines()] == [label]
    (data,) = plot_data([plot])
    assert data["board"] == title and data["series"][0]["name"] == label
