"""Messages about photographs and their poses."""

from __future__ import annotations

import pytest

from dofbench.scenes.reconstruction.report import ViewReport, median_points, remarks


def _view(name, points, registered=True):
    why = {} if registered else {"why": "no features", "advice": "leave it out"}
    return ViewReport(name, registered, 500, 20, 1.0, 3, 90, points, 0.5 if registered else None, **why)


@pytest.mark.parametrize(("points", "doubtful"), [((8, 12, 20), True), ((29, 29, 500), True), ((10, 30, 31), False)])
def test_poses_from_too_few_points_are_called_doubtful(points, doubtful):
    """By the view in the middle: a single weak photograph doesn't condemn the others."""
    lines = remarks([_view(str(count), count) for count in points], False)
    assert any("doubtful" in line and f"{sorted(points)[1]} points" in line for line in lines) == doubtful


def test_photographs_without_a_pose_have_no_part_in_it():
    reports = [_view("a", 100), _view("b", 80), _view("c", 0, registered=False)]
    assert median_points(reports) == 90
    assert not any("doubtful" in line for line in remarks(reports, False))
    assert median_points(reports[2:]) is None
