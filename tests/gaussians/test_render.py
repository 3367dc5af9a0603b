"""The arguments that `rasterise` passes to the kernel."""

import numpy as np
import torch
from random_gaussians import scene, view

from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise, rasterise_from_points


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
