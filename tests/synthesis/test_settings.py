"""Options: what they mean, and one line for each wrong one."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from tolerances import FLOAT64_VALUE

from dofbench.core.errors import InputError
from dofbench.synthesis.dataset_options import MakeDataset, MakeDatasets


def test_lists_are_numbers_in_the_order_given():
    settings = MakeDataset(focus="0.8, 0.2", aperture="1")
    assert settings.focus_values == (0.8, 0.2) and settings.aperture_values == (1.0,)


def test_polygon():
    shape = MakeDataset(shape="5-gon", shape_rotation=90, shape_curvature=0.25, shape_obstruction=0.1).aperture_shape
    assert (shape.blades, shape.curvature, shape.obstruction) == (5, 0.25, 0.1)
    assert shape.rotation == pytest.approx(math.pi / 2, rel=FLOAT64_VALUE)


@pytest.mark.parametrize(
    "options, word",
    [
        ({"focus": "0.2,,0.5"}, "--focus"),
        ({"focus": ""}, "--focus"),
        ({"focus": "near"}, "--focus"),
        ({"focus": "nan"}, "--focus"),
        ({"aperture": "1.5"}, "--aperture"),
        ({"aperture": "-0.1"}, "--aperture"),
        ({"aperture": "0.5,0.50"}, "every value once"),
        ({"width": 2}, "--width"),
        ({"hold": 1}, "--hold"),
        ({"depth_steps": 0}, "--depth-steps"),
        ({"gamma": 0.0}, "--gamma"),
        ({"alpha": math.inf}, "--alpha"),
        ({"seed": -1}, "--seed"),
        ({"shape": "square"}, "--shape"),
        ({"shape": "2-gon"}, "--shape"),
        ({"shape_rotation": 10.0}, "--shape"),
        ({"shape": "6-gon", "shape_curvature": 2.0}, "--shape-curvature"),
        ({"shape_obstruction": 1.0}, "--shape-obstruction"),
        ({"shape": "6-gon", "shape_rotation": math.nan}, "degrees"),
        ({"assign": "fixed"}, "--assign fixed"),
        ({"assign": "held-out"}, "--test-focus"),
        ({"test_focus": "0.5"}, "--assign held-out"),
        ({"test_aperture": "0"}, "--assign held-out"),
        ({"assign": "held-out", "test_focus": "0.2,0.4"}, "a training focus too"),
        ({"assign": "held-out", "test_focus": "far"}, "--test-focus"),
        ({"assign": "continuous"}, "two ends of a range"),
        ({"depth": "folder"}, "folder:DIR"),
        ({"depth": "magic"}, "--depth"),
        ({"depth_unit": 0.0}, "--depth-unit"),
        ({"photons": -1.0}, "--photons"),
        ({"read_noise": math.nan}, "--read-noise"),
    ],
)
def test_a_wrong_option_is_one_line(options, word):
    with pytest.raises(InputError) as caught:
        MakeDataset(**options)
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_fixed_takes_one_lens_a_dataset():
    assert MakeDataset(assign="fixed", focus="0.5", aperture="1").focus_values == (0.5,)
    with pytest.raises(InputError, match="3 focus and 2 aperture values"):
        MakeDataset(assign="fixed")
    several = MakeDatasets(assign="fixed", focus="0.1,0.25", aperture="1", photons=5.0, scenes=("a", "b"))
    lenses = several.lenses()
    assert lenses == (("F0.1-A1", 0.1, 1.0), ("F0.25-A1", 0.25, 1.0))
    one = several.one("b", Path("out"), lenses[1])
    assert (one.focus_values, one.aperture_values, one.photons) == ((0.25,), (1.0,), 5.0)
    assert (one.scene, one.out) == ("b", Path("out"))
    assert MakeDatasets().lenses() == (None,)


def test_the_command_says_what_differs_from_the_defaults():
    assert MakeDataset().command("planes") == "dofbench make-dataset planes"
    text = MakeDataset(scene="/somewhere/planes", focus="0.5", hold=4, out="elsewhere").command("planes")
    assert text == "dofbench make-dataset planes --focus 0.5 --hold 4"


def test_held_out_tests_at_aperture_zero_too_unless_told():
    settings = MakeDataset(assign="held-out", focus="0.2,0.8", test_focus="0.5")
    assert settings.held_out_values.focus == (0.5,) and settings.held_out_values.aperture == (0.0, 0.5, 1.0)
    told = MakeDataset(assign="held-out", focus="0.2", test_focus="0.5", test_aperture="1")
    assert told.held_out_values.aperture == (1.0,)
    assert "--assign held-out --test-focus 0.5 --test-aperture 0,0.5,1" in settings.command("planes")


def test_a_continuous_range_may_be_one_value():
    assert MakeDataset(assign="continuous", focus="0.1,0.9", aperture="1").values.aperture == (1.0,)
