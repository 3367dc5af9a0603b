"""A scene split by the f-numbers in its EXIF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import cloud

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes import load_scene
from dofbench.scenes.readers.exif_files import split_by_f_number


@pytest.fixture
def scene():
    """Six views at f/2, f/5.6, f/2, f/8, unknown and f/2; each point is seen by the view of its number."""
    whole = load_scene(content_folder("datasets") / "tabletop", width=64)
    numbers = (2.0, 5.6, 2.0, 8.0, None, 2.001)
    views = tuple(
        replace(view, exif=None if number is None else Exif(f_number=number))
        for view, number in zip(whole.views, numbers, strict=False)
    )
    points = cloud(np.arange(18.0), [np.array([index]) for index in range(6)])
    return replace(whole, views=views, points=points)


def test_views_are_chosen_by_their_f_number(scene):
    found = split_by_f_number(scene, 2.0, 5.6)
    names = [view.name for view in scene.views]
    assert {view.name: view.split for view in found.views} == {
        names[0]: "train",
        names[1]: "test",
        names[2]: "train",
        names[5]: "train",
    }
    assert np.array_equal(found.points.xyz, scene.points.xyz[[0, 1, 2, 5]])
    assert [track.tolist() for track in found.points.views] == [[0], [1], [2], [3]]


def test_views_to_test_with_that_share_too_little_are_left_out(scene):
    tracks = ([0, 1], [2, 1], [5, 3], [0, 2], [3, 1], [1])  # views 0, 2, 5 at f/2; 1 at f/5.6; 3 at f/8
    points = replace(scene.points, views=tuple(np.array(sorted(track)) for track in tracks))
    tracked = replace(scene, points=points)
    assert len(split_by_f_number(tracked, 2.0, 5.6, test_points=2).views) == 4
    with pytest.raises(InputError, match="2 shared points at most.*at least 3"):
        split_by_f_number(tracked, 2.0, 5.6, test_points=3)
    assert [view.split for view in split_by_f_number(tracked, 2.0, 8.0, test_points=1).views].count("test") == 1
    with pytest.raises(InputError, match="1 shared points at most"):
        split_by_f_number(tracked, 2.0, 8.0, test_points=2)


@pytest.mark.parametrize(("train", "test", "option"), [(2.8, 5.6, "--train-f-number"), (2.0, 11.0, "--test-f-number")])
def test_an_f_number_that_no_view_has_is_one_line(scene, train, test, option):
    with pytest.raises(InputError) as found:
        split_by_f_number(scene, train, test)
    assert found.value.subject == option and "f/2 (2), f/2.001 (1), f/5.6 (1), f/8 (1)" in str(found.value)


def test_without_exif_the_line_says_where_it_could_stand(scene, tmp_path):
    blank = replace(scene, views=tuple(replace(view, exif=None) for view in scene.views))
    with pytest.raises(InputError, match=r"exif\.csv"):
        split_by_f_number(blank, 2.0, 5.6)


@pytest.mark.parametrize(
    ("options", "subject", "found"),
    [
        ({"train_f_number": 2.0}, "--train-f-number", "no --test-f-number"),
        ({"test_f_number": 2.0}, "--test-f-number", "no --train-f-number"),
        ({"train_f_number": 2.0, "test_f_number": 2.0}, "--train-f-number", "as --test-f-number"),
        ({"train_f_number": -2.0, "test_f_number": 8.0}, "--train-f-number", "found -2"),
        ({"train_f_number": 2.0, "test_f_number": 8.0, "hold": 8}, "--train-f-number", "--hold 8 too"),
    ],
)
def test_options_that_dont_fit(options, subject, found):
    with pytest.raises(InputError) as refused:
        MakeDataset(**options)
    assert refused.value.subject == subject and found in str(refused.value)
