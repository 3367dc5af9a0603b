"""The one value that says how a lens blurs: checked when made, light to import."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError

import pytest
from called import imported_by

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape
from dofbench.datasets.format.schema import LensFile


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ({"gamma": 0.0}, "gamma: found 0.0, expected a positive number"),
        ({"gamma": math.inf}, "gamma: found inf, expected a positive number"),
        ({"alpha": -4.0}, "alpha: found -4.0, expected a positive number"),
        ({"alpha": math.nan}, "alpha: found nan, expected a positive number"),
        ({"energy": "all"}, "energy: found 'all', expected one of area, algorithm1"),
        ({"renderer": "magic"}, "renderer: found 'magic', expected one of scatter, layered, thinlens, light-field"),
        ({"layers": 0}, "layers: found 0, expected at least 1"),
    ],
)
def test_what_does_not_exist_is_refused_by_name(fields, line):
    with pytest.raises(InputError) as caught:
        Blur(**fields)
    assert str(caught.value) == line
    assert caught.value.subject == next(iter(fields))


def test_it_stays_what_it_was_when_checked():
    with pytest.raises(FrozenInstanceError):
        Blur().gamma = 0.0  # type: ignore[misc]
    assert Blur(shape=ApertureShape(5)) == Blur(shape=ApertureShape(5)) != Blur()


def test_importing_it_loads_no_arrays():
    assert not {"numpy", "torch", "pydantic"} & imported_by("import dofbench.core.blur")


@pytest.mark.parametrize(
    "blur", [Blur(), Blur(1.0, 2.0, ApertureShape(5, 0.1, 0.2, 0.3), "algorithm1"), Blur(renderer="layered", layers=3)]
)
def test_a_dataset_gives_back_the_blur_that_it_keeps(blur):
    lenses = LensFile(disparity_range=(0.1, 1.0), normaliser="scene", **LensFile.of_blur(blur), views=())
    assert lenses.blur == blur
    assert (lenses.layers is None) is (blur.renderer != "layered")
