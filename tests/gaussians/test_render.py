"""The arguments that `rasterise` passes to the kernel."""

import numpy as np
import torch
from random_gaussians import scene, view

from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.render import AppearanceOptions, rasterise


def test_other_means_are_taken_and_get_the_gradient():
    parameters, shift = scene(30, 1), torch.tensor([0.2, -0.1, 0.3])
    gaussians = Gaussians(dict(parameters))
    shifted = Gaussians({**parameters, "means": parameters["means"] + shift})
    shift.requires_grad_()
    raster = rasterise(
        gaussians, view(), AppearanceOptions(filter_3d=False), means=gaussians.parameters["means"] + shift
    )
    assert torch.equal(raster.color, rasterise(shifted, view(), AppearanceOptions(filter_3d=False)).color)
    raster.color.sum().backward()
    assert np.allclose(gaussians.parameters["means"].grad.sum(0), shift.grad)
    assert shift.grad.any()


def test_blur_reaches_the_kernel_and_gets_the_gradient():
    gaussians, blur = Gaussians(scene(30, 2)), torch.full((30,), 9.0, requires_grad=True)
    options = AppearanceOptions(filter_3d=False)
    raster = rasterise(gaussians, view(), options, blur=blur)
    assert not torch.equal(raster.color, rasterise(gaussians, view(), options).color)
    raster.color.square().sum().backward()
    assert blur.grad.any()


def test_harmonics_come_one_degree_at_a_time_or_all_at_once():
    gradual, at_once = AppearanceOptions(sh_degree=2, sh_every=0.25), AppearanceOptions(sh_degree=2, sh_every=0.0)
    assert [gradual.degree(progress) for progress in (0.0, 0.2, 0.25, 0.5, 0.75, 1.0)] == [0, 0, 1, 2, 2, 2]
    assert [at_once.degree(progress) for progress in (0.0, 0.5, 1.0)] == [2, 2, 2]
