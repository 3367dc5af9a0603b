"""The Gaussians that training starts from, and the arguments of their rasterisation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import cloud
from random_gaussians import scene, view
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise, rasterise_from_points

SPREAD = np.random.default_rng(5).uniform(size=(40, 3))


def _scales(xyz: np.ndarray) -> np.ndarray:
    """(N, 3) deviations, scene units."""
    started = Gaussians.from_points(cloud(xyz, rgb=np.full((len(xyz), 3), 0.5)), 0)
    return np.exp(started.parameters["log_scales"].detach().double().numpy())


def test_a_point_is_as_large_as_the_root_mean_square_distance_to_its_three_neighbours() -> None:
    distances = np.sort(np.linalg.norm(SPREAD[:, None] - SPREAD[None], axis=2), axis=1)[:, 1:4]
    expected = np.sqrt((distances**2).mean(axis=1))
    assert _scales(SPREAD) == pytest.approx(np.repeat(expected[:, None], 3, axis=1), rel=FLOAT32_SCALAR)


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_points_that_coincide_have_a_size_that_follows_the_scene_s_unit(unit: float) -> None:
    """Four at one place have neighbours at no distance at all."""
    xyz = np.concatenate([np.repeat(SPREAD[:1], 4, axis=0), SPREAD[1:]])
    scales = _scales(xyz)
    assert np.median(scales) / 200 < scales[:4].max() < np.median(scales) / 50
    assert _scales(xyz * unit) == pytest.approx(scales * unit, rel=FLOAT32_VALUE)


@pytest.mark.parametrize(
    ("xyz", "found"), [(SPREAD[:3], "3"), (np.repeat(SPREAD[:1], 9, axis=0), "all at the same place")]
)
def test_too_few_places_are_the_user_s_mistake(xyz: np.ndarray, found: str) -> None:
    with pytest.raises(InputError, match=found):
        _scales(xyz)


def test_radius_and_blur_reach_the_kernel_and_get_the_gradient():
    gaussians, options = Gaussians(scene(30, 2)), AppearanceOptions(filter_3d=False, background=0.3)
    points = np.array([[0.0, 0.0], [0.5, -0.5]])

    def seen(radius, blur):
        given = (torch.full((30,), value, requires_grad=True) for value in (radius, blur))
        radius, blur = given
        return rasterise_from_points(gaussians, view(), options, points, radius, blur), radius, blur

    images, radius, blur = seen(3.0, 9.0)
    plain = rasterise(gaussians, view(), options, geometry="none").color
    closed, *_ = seen(0.0, 0.0)
    assert torch.equal(closed[0], plain) and torch.equal(closed[1], plain)
    assert not torch.equal(images[0], plain) and not torch.equal(images[0], images[1])
    images.square().sum().backward()
    assert radius.grad.any() and blur.grad.any()


def test_the_filters_and_the_degree_are_the_same_from_every_point():
    gaussians, nothing = Gaussians(scene(30, 4)), torch.zeros(30)
    gaussians.filter_3d = torch.full((30,), 0.05)
    for options in (AppearanceOptions(), AppearanceOptions(filter_3d=False, filter_2d=0.5)):
        (image,) = rasterise_from_points(gaussians, view(), options, np.zeros((1, 2)), nothing, nothing, sh_degree=1)
        assert torch.equal(image, rasterise(gaussians, view(), options, sh_degree=1, geometry="none").color)


def test_harmonics_come_one_degree_at_a_time_or_all_at_once():
    gradual, at_once = AppearanceOptions(sh_degree=2, sh_every=0.25), AppearanceOptions(sh_degree=2, sh_every=0.0)
    assert [gradual.degree(progress) for progress in (0.0, 0.2, 0.25, 0.5, 0.75, 1.0)] == [0, 0, 1, 2, 2, 2]
    assert [at_once.degree(progress) for progress in (0.0, 0.5, 1.0)] == [2, 2, 2]
