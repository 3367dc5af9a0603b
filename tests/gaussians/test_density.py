import math

import numpy as np
import pytest
import torch
from made_up import cloud, frontal

from dofbench.compute.raster import ViewStatistics
from dofbench.core.errors import InputError
from dofbench.gaussians.density import DensityControl, DensityOptions, rotate
from dofbench.gaussians.model import PARAMETERS, Gaussians, scene_extent
from dofbench.gaussians.optimiser import GaussianOptimiser, RateOptions


def _setup(count=12, **overrides):
    generator = np.random.default_rng(3)
    points = cloud(generator.normal(size=(count, 3)), rgb=generator.uniform(size=(count, 3)))
    gaussians = Gaussians.from_points(points, 1)
    options = DensityOptions(**{"densify_from": 0.0, "densify_every": 1, "reset_every": 0.0, **overrides})
    optimiser = GaussianOptimiser(gaussians, RateOptions(), 1.0)
    for name in PARAMETERS:
        gaussians.parameters[name].grad = torch.ones_like(gaussians.parameters[name])
    optimiser.step(0.0)
    density = DensityControl(gaussians, optimiser, options, 1.0, torch.Generator().manual_seed(0))
    return gaussians, optimiser, density


def _see(density, gradient):
    density.record(ViewStatistics(visible=torch.ones(len(gradient), dtype=torch.bool), grad_2d=gradient), 10, 10)


def _record(gaussians, density, growing):
    gradient = torch.zeros(len(gaussians), 2)
    gradient[growing, 0] = 1.0
    _see(density, gradient)


def test_large_ones_split_small_ones_clone_transparent_ones_go():
    gaussians, _, density = _setup()
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = math.log(1e-4)
        gaussians.parameters["log_scales"][0] = math.log(0.5)
        gaussians.parameters["opacity_logits"][5] = -20.0
    before = gaussians.parameters["means"].detach().clone()
    _record(gaussians, density, [0, 1])
    assert density.after_step(1, 0.0)
    # 12 - 1 split parent - 1 transparent + 2 children + 1 clone
    assert len(gaussians) == 13
    means = gaussians.parameters["means"].detach()
    assert int((means == before[1]).all(dim=1).sum()) == 2
    assert not bool((means == before[0]).all(dim=1).any()) and not bool((means == before[5]).all(dim=1).any())
    assert torch.allclose(gaussians.parameters["log_scales"][-1].detach(), torch.tensor(math.log(0.5 / 1.6)))


def test_moments_follow_their_gaussians_and_new_ones_start_at_zero():
    gaussians, optimiser, density = _setup()
    _record(gaussians, density, [2])
    density.after_step(1, 0.0)
    for group in optimiser._adam.param_groups:
        parameter = group["params"][0]
        assert parameter is gaussians.parameters[group["name"]]
        moment = optimiser._adam.state[parameter]["exp_avg"]
        assert moment.shape == parameter.shape
        assert bool((moment[:11] != 0).all()) and bool((moment[12:] == 0).all())
        parameter.grad = torch.ones_like(parameter)
    optimiser.step(0.5)


def test_the_cap_keeps_the_neediest():
    gaussians, _, density = _setup(max_gaussians=13)
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = math.log(1e-4)
    gradient = torch.zeros(12, 2)
    gradient[:, 0] = torch.arange(12) + 1.0
    _see(density, gradient)
    wanted = gaussians.parameters["means"].detach()[11].clone()
    density.after_step(1, 0.0)
    assert len(gaussians) == 13
    assert int((gaussians.parameters["means"].detach() == wanted).all(dim=1).sum()) == 2


def test_opacity_reset_lowers_opacity_and_forgets_moments():
    gaussians, optimiser, density = _setup(reset_every=0.1, densify_every=1000)
    density.after_step(1, 0.15)
    opacity = torch.sigmoid(gaussians.parameters["opacity_logits"].detach())
    assert float(opacity.max()) <= 0.01 + 1e-6
    assert float(optimiser._adam.state[gaussians.parameters["opacity_logits"]]["exp_avg"].abs().max()) == 0


def test_rotate_is_the_rotation_matrix():
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(0)
    quaternions, vectors = generator.normal(size=(20, 4)), generator.normal(size=(20, 3))
    expected = Rotation.from_quat(np.roll(quaternions, -1, axis=1)).apply(vectors)
    assert np.allclose(rotate(torch.from_numpy(quaternions), torch.from_numpy(vectors)).numpy(), expected)


def test_filter_3d_is_the_finest_sampling_of_the_views_that_see_a_gaussian():
    gaussians = Gaussians.from_points(cloud([(0, 0, 2.0), (0, 0, 8.0), (0.1, 0, 4.0), (50.0, 0, 4.0)]), 0)
    gaussians.update_filter_3d([frontal(20, 20, 10.0), frontal(40, 40, 20.0)])
    # The Gaussian that no view sees gets the largest size of the others
    finest = np.array([2, 8, 4, 8]) / 20 * math.sqrt(0.2)
    assert np.allclose(gaussians.filter_3d.numpy(), finest)


def test_saving_and_loading_gives_the_same_bits(tmp_path):
    gaussians, _, _ = _setup()
    gaussians.filter_3d = torch.rand(len(gaussians))
    gaussians.save(tmp_path / "scene.npz")
    loaded = Gaussians.load(tmp_path / "scene.npz")
    for name in PARAMETERS:
        assert torch.equal(loaded.parameters[name], gaussians.parameters[name])
    assert torch.equal(loaded.filter_3d, gaussians.filter_3d) and loaded.max_sh_degree == 1


@pytest.mark.parametrize("content", [b"", b"not an archive"])
def test_loading_something_else_is_one_clear_line(tmp_path, content):
    path = tmp_path / "scene.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="saved Gaussians"):
        Gaussians.load(path)


def test_no_points_is_the_users_mistake():
    with pytest.raises(InputError, match="at least 4"):
        Gaussians.from_points(None, 3)


def test_extent_of_a_single_camera_is_one():
    assert scene_extent([frontal(2, 2, 1.0)]) == 1.0
