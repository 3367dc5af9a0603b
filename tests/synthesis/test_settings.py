"""Options: what they mean, and one line for each wrong one."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest
from tolerances import FLOAT64_VALUE

from dofbench.cli import app
from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape
from dofbench.datasets.synthesis.dataset_options import About, DatasetOptions, MakeDataset, MakeDatasets


def test_lists_are_numbers_in_the_order_given():
    settings = app.parse(["make-dataset", "--focus", "0.8, 0.2", "--aperture", "1"])
    assert settings.focus == (0.8, 0.2) and settings.aperture == (1.0,)
    assert MakeDataset(aperture=(0, 1)).recipe()["aperture"] == [0.0, 1.0]
    assert {type(value) for value in MakeDataset(aperture=[0, 1]).aperture} == {float}


@pytest.mark.parametrize("text", ["0.2,,0.5", "", "near", "0.2;0.5"])
@pytest.mark.parametrize("option", ["--focus", "--aperture", "--test-focus", "--test-aperture"])
def test_what_is_no_list_of_numbers_is_one_line(option, text):
    with pytest.raises(InputError) as caught:
        app.parse(["make-dataset", "--assign", "held-out", option, text])
    assert str(caught.value) == f"{option}: found {text!r}, expected numbers separated by commas, such as 0.2,0.5"


def test_a_list_may_be_text_or_numbers():
    assert MakeDataset(focus="0.2,0.5").focus == MakeDataset(focus=[0.2, 0.5]).focus == (0.2, 0.5)
    with pytest.raises(InputError, match="--focus"):
        MakeDataset(focus=("near",))


def test_polygon():
    shape = MakeDataset(shape="5-gon", shape_rotation=90, shape_curvature=0.25, shape_obstruction=0.1).aperture_shape
    assert (shape.blades, shape.curvature, shape.obstruction) == (5, 0.25, 0.1)
    assert shape.rotation == pytest.approx(math.pi / 2, rel=FLOAT64_VALUE)


@pytest.mark.parametrize(
    "options, word",
    [
        ({"focus": (math.nan,)}, "--focus: found nan"),
        ({"aperture": (0.5, 1.5)}, "--aperture: found 1.5, expected at most 1"),
        ({"aperture": (-0.1,)}, "--aperture: found -0.1"),
        ({"aperture": (0.5, 0.5)}, "every value once"),
        ({"aperture": ()}, "--aperture"),
        ({"width": 2}, "--width"),
        ({"hold": 1}, "--hold"),
        ({"depth_steps": 0}, "--depth-steps"),
        ({"gamma": 0.0}, "--gamma: found 0.0"),
        ({"alpha": math.inf}, "--alpha"),
        ({"seed": -1}, "--seed"),
        ({"shape": "square"}, "--shape"),
        ({"shape": "2-gon"}, "--shape"),
        ({"shape_rotation": 10.0}, "--shape"),
        ({"shape": "6-gon", "shape_curvature": 2.0}, "--shape-curvature"),
        ({"shape_obstruction": 1.0}, "--shape-obstruction"),
        ({"shape": "6-gon", "shape_rotation": math.nan}, "--shape-rotation"),
        ({"assign": "fixed"}, "--assign fixed"),
        ({"assign": "held-out"}, "--test-focus"),
        ({"test_focus": (0.5,)}, "--test-focus: found --assign per-view, expected --assign held-out"),
        ({"test_aperture": (0.0,)}, "--test-aperture: found --assign per-view, expected --assign held-out"),
        ({"assign": "held-out", "test_focus": (0.2, 0.4)}, "a training focus too"),
        ({"assign": "held-out", "test_focus": (2.0,)}, "--test-focus: found 2"),
        ({"renderer": "thinlens", "gamma": 2.0}, "--renderer thinlens: found --gamma 2, expected 2.2"),
        ({"renderer": "thinlens", "shape": "6-gon"}, "--renderer thinlens: found --shape 6-gon, expected a disc"),
        ({"renderer": "thinlens", "shape_obstruction": 0.5}, "--renderer thinlens: found --shape-obstruction 0.5"),
        ({"layers": 0}, "--layers: found 0, expected at least 1"),
        ({"lens_samples": 1}, "--lens-samples"),
        ({"test_points": -1}, "--test-points"),
        (
            {"assign": "continuous"},
            "--focus with --assign continuous: found 3 values, expected the two ends of a range",
        ),
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
    assert MakeDataset(assign="fixed", focus=(0.5,), aperture=(1,)).focus == (0.5,)
    with pytest.raises(InputError, match="3 focus and 2 aperture values"):
        MakeDataset(assign="fixed")
    several = MakeDatasets(assign="fixed", focus=(0.1, 0.25), aperture=(1.0,), photons=5.0, scenes=("a", "b"))
    lenses = several.lenses()
    assert lenses == (("F0.1-A1", 0.1, 1.0), ("F0.25-A1", 0.25, 1.0))
    one = several.one("b", Path("out"), lenses[1])
    assert (one.focus, one.aperture, one.photons) == ((0.25,), (1.0,), 5.0)
    assert (one.scene, one.out) == ("b", Path("out"))
    assert MakeDatasets().lenses() == (None,)


def test_the_command_says_what_differs_from_the_defaults():
    assert MakeDataset().command("planes") == "dofbench make-dataset planes"
    text = MakeDataset(scene="/somewhere/planes", focus=(0.5,), hold=4, out="elsewhere").command("planes")
    assert text == "dofbench make-dataset planes --focus 0.5 --hold 4"
    assert MakeDataset(skip_missing=True).command("planes") == "dofbench make-dataset planes --skip-missing"


def test_held_out_tests_at_aperture_zero_too_unless_told():
    settings = MakeDataset(assign="held-out", focus=(0.2, 0.8), test_focus=(0.5,))
    assert settings.held_out_values.focus == (0.5,) and settings.held_out_values.aperture == (0.0, 0.5, 1.0)
    told = MakeDataset(assign="held-out", focus=(0.2,), test_focus=(0.5,), test_aperture=(1.0,))
    assert told.held_out_values.aperture == (1.0,)
    assert "--assign held-out --test-focus 0.5 --test-aperture 0,0.5,1" in settings.command("planes")


def test_a_continuous_range_may_be_one_value():
    assert MakeDataset(assign="continuous", focus=(0.1, 0.9), aperture=(1.0,)).values.aperture == (1.0,)


def test_a_polygon_that_bulges_to_a_disc_is_one_for_the_thin_lens():
    assert MakeDataset(renderer="thinlens", shape="6-gon", shape_curvature=1.0).aperture_shape.is_disc


def test_every_option_says_what_it_is_about():
    """An option that is added without saying so would be refused nowhere, or kept in no manifest."""
    for at in fields(DatasetOptions):
        assert at.metadata["about"] in get_args(About), at.name
    one, several = ({at.name: at.metadata for at in fields(kind)} for kind in (MakeDataset, MakeDatasets))
    shared = {at.name: at.metadata for at in fields(DatasetOptions)}
    assert shared.items() <= one.items() and shared.items() <= several.items()


def test_the_recipe_keeps_what_decides_the_content_in_the_order_of_the_options():
    names = [at.name for at in fields(DatasetOptions)]
    places = ("data_root", "out", "reuse")
    chosen = ("points", "photographs", "train_f_number", "test_f_number", "test_points", "coverage")
    left_out = {*places, *chosen, "alpha_channel", "skip_missing", "spacing"}
    assert list(MakeDataset().recipe()) == [name for name in names if name not in left_out]
    asked = MakeDataset(
        alpha_channel="mask",
        points="shallow",
        photographs="shallow",
        train_f_number=2.0,
        test_f_number=8.0,
        skip_missing=True,
        coverage=True,
        out=Path("there"),
    )
    assert list(asked.recipe()) == [name for name in names if name not in (*places, "spacing")]
    kept = ["width", "hold", "depth", "depth_unit", "images", "layout"]
    assert list(MakeDataset().photograph_recipe()) == [*kept, "photographs"]
    of_photographs = ["alpha_channel", "skip_missing", *chosen]
    assert list(asked.photograph_recipe()) == [*kept, *of_photographs]
    of_views = [at.name for at in fields(DatasetOptions) if at.metadata["light_field"]]
    field = MakeDataset(photographs="light-field", points="shallow", spacing=3)
    assert list(field.recipe()) == of_views and not {"depth", "renderer", "alpha", "photons"} & set(of_views)


def test_the_command_of_a_light_field_says_its_apertures():
    """Their default depends on the grid, so those of another scene say nothing."""
    field = MakeDataset(photographs="light-field", aperture=(0.5, 1.0))
    assert "--aperture 0.5,1" in field.command("chess")
    assert "--aperture" not in MakeDataset(aperture=(0.5, 1.0)).command("fern")


def test_the_settings_give_the_blur_that_they_describe():
    asked = MakeDataset(gamma=2.0, alpha=3.0, shape="5-gon", energy="algorithm1", renderer="layered", layers=4)
    assert asked.blur == Blur(2.0, 3.0, ApertureShape(5), "algorithm1", "layered", 4)
