"""A trained scene rendered through any lens and shape of the aperture."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens
from dofbench.optics.defocus import defocus_numpy
from dofbench.running.load_run import load_run
from dofbench.running.model import Model

HEXAGON = ApertureShape(blades=6)


def test_the_methods_own_lens_renders_where_the_aperture_is_a_disc(call) -> None:
    run = load_run(call().folder)
    view = run.dataset.test_views()[1]
    own = run.method.render(view.camera, view.physical_lens).image
    assert np.array_equal(run.model.render(view.camera, view.physical_lens).image, own)
    assert np.array_equal(run.model.render(view.camera, view.lens).image, own)  # in units of the dataset's range
    assert np.array_equal(run.model.render(view.camera).image, run.method.render(view.camera, None).image)


@pytest.mark.parametrize("shape", [HEXAGON, ApertureShape()])
def test_another_shape_and_a_method_without_a_lens_are_blurred_by_depth(call, shape: ApertureShape) -> None:
    run = load_run(call(set=("lens=false",) if shape.is_disc else ()).folder)
    camera, lens = run.dataset.test_views()[0].camera, PhysicalLens(8.0, 0.5, 64)
    sharp = run.method.render(camera, None)
    expected, _ = defocus_numpy(sharp.image, sharp.depth, lens, Blur(shape=shape, renderer="layered"))
    found = run.model.render(camera, lens, shape)
    assert np.array_equal(found.image, expected) and not np.array_equal(found.image, sharp.image)
    assert np.array_equal(run.model.render(camera, shape=shape).image, sharp.image)


def test_a_lens_in_units_of_no_range_is_refused_and_a_physical_one_needs_no_dataset(call, tmp_path: Path) -> None:
    run = load_run(call().folder)
    camera = run.dataset.test_views()[0].camera
    model = Model(run.method)
    with pytest.raises(InputError, match="without a disparity range"):
        model.render(camera, Lens(1.0, 0.5))
    (tmp_path / "data").rename(tmp_path / "gone")
    alone = load_run(run.folder, tmp_path / "data").model
    lens = PhysicalLens(8.0, 0.5, 64)
    assert np.array_equal(alone.render(camera, lens).image, model.render(camera, lens).image)


def test_a_lens_given_to_what_takes_a_physical_one_says_what_to_do(call) -> None:
    run, lens = load_run(call().folder), Lens(1.0, 0.5)
    with pytest.raises(AttributeError, match=r"found a Lens, .*expected a PhysicalLens"):
        run.method.render(run.dataset.views[0].camera, lens)
    with pytest.raises(AttributeError, match="no attribute 'colour'"):
        _ = lens.colour
    assert pickle.loads(pickle.dumps(lens)) == copy.deepcopy(lens) == lens


def test_the_range_of_a_depth_map_is_that_of_its_known_disparities() -> None:
    import torch

    depth = np.random.default_rng(1).uniform(1.0, 9.0, (30, 40))
    expected = DisparityRange.of_disparity(1.0 / depth)
    spoiled = np.concatenate([depth, np.array([[0.0, -1.0, np.nan, np.inf] * 10])])
    assert DisparityRange.of(spoiled) == expected == DisparityRange.of(torch.tensor(depth, requires_grad=True))
    with pytest.raises(ValueError, match="found none"):
        DisparityRange.of(np.zeros((2, 2)))
