"""A scene split by what its cameras wrote down."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dofbench.content import content_folder
from dofbench.contracts import PointCloud
from dofbench.errors import InputError
from dofbench.exif import Exif
from dofbench.scenes import load_scene
from dofbench.scenes.by_exif import split_by_f_number
from dofbench.scenes.types import Scene


@pytest.fixture
def scene() -> Scene:
    """Six views at f/2, f/5.6, f/2, f/8, unknown and f/2; each point is seen by the view of its number."""
    whole = load_scene(content_folder("datasets") / "tabletop", width=64)
    numbers = (2.0, 5.6, 2.0, 8.0, None, 2.001)
    views = tuple(replace(view, exif=None if number is None else Exif(f_number=number))
                  for view, number in zip(whole.views, numbers, strict=False))
    points = PointCloud(np.arange(18.0).reshape(6, 3), np.zeros((6, 3), np.float32), np.zeros(6, np.float32),
                        tuple(np.array([index]) for index in range(6)))
    return replace(whole, views=views, points=points)


def test_views_are_chosen_by_their_f_number(scene: Scene) -> None:
    found = split_by_f_number(scene, 2.0, 5.6)
    names = [view.name for view in scene.views]
    assert {view.name: view.split for view in found.views} == {
        names[0]: "train", names[1]: "test", names[2]: "train", names[5]: "train"}
    assert np.array_equal(found.points.xyz, scene.points.xyz[[0, 1, 2, 5]])
    assert [track.tolist() for track in found.points.views] == [[0], [1], [2], [3]]


@pytest.mark.parametrize(("train", "test", "option"), [(2.8, 5.6, "--train-f-number"), (2.0, 11.0, "--test-f-number")])
def test_an_f_number_that_no_view_has_is_one_line(scene: Scene, train: float, test: float, option: str) -> None:
    with pytest.raises(InputError) as found:
        split_by_f_number(scene, train, test)
    assert found.value.subject == option and "f/2 (2), f/2.001 (1), f/5.6 (1), f/8 (1)" in str(found.value)


def test_without_exif_the_line_says_where_it_could_stand(scene: Scene, tmp_path: Path) -> None:
    blank = replace(scene, views=tuple(replace(view, exif=None) for view in scene.views))
    with pytest.raises(InputError, match=r"exif\.csv"):
        split_by_f_number(blank, 2.0, 5.6)
