import math
from dataclasses import asdict

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import DEVIATION_OF_4000, FLOAT32_SCALAR

from dofbench.compute.raster import ViewStatistics
from dofbench.core.errors import InputError
from dofbench.gaussians.density import DensityControl, DensityOptions, rotate
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.model import PARAMETERS, Gaussians, scene_extent
from dofbench.gaussians.optimiser import GaussianOptimiser, RateOptions
from dofbench.running.method_cards import find_method


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
    assert float(opacity.max()) == pytest.approx(0.01, rel=FLOAT32_SCALAR)
    assert float(optimiser._adam.state[gaussians.parameters["opacity_logits"]]["exp_avg"].abs().max()) == 0


def test_an_opacity_may_be_reset_as_it_is_after_the_3d_filter():
    gaussians, _, density = _setup(reset_every=0.1, densify_every=1000, reset_filtered=True)
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = math.log(0.5)
        gaussians.parameters["opacity_logits"][3] = -9.0
    gaussians.filter_3d = torch.linspace(0.0, 0.5, 12)
    before = torch.sigmoid(gaussians.parameters["opacity_logits"].detach())
    density.after_step(1, 0.15)
    opacity = torch.sigmoid(gaussians.parameters["opacity_logits"].detach())
    # A cube of side 0.5 that is widened to sqrt(0.25 + f^2) loses the ratio of the two volumes.
    kept = (0.5 / torch.sqrt(0.25 + gaussians.filter_3d**2)) ** 3
    expected = torch.full((12,), 0.01)
    expected[3] = before[3] * kept[3]  # was below it, and stays as it is
    assert np.allclose((opacity * kept).numpy(), expected.numpy(), rtol=FLOAT32_SCALAR, atol=0)
    assert opacity[-1] > 2 * opacity[0]


def test_a_clone_may_be_put_where_the_original_s_distribution_draws_it():
    gaussians, _, density = _setup(count=4000, clone_place="drawn")
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = torch.log(torch.tensor([1e-3, 2e-3, 4e-3]))
        gaussians.parameters["quaternions"][:] = torch.tensor([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    before = gaussians.parameters["means"].detach().clone()
    _record(gaussians, density, slice(None))
    density.after_step(1, 0.0)
    means = gaussians.parameters["means"].detach()
    assert len(means) == 8000 and torch.equal(means[:4000], before)
    # A quarter turn about z exchanges the first two axes.
    deviation = (means[4000:] - before).std(dim=0).numpy()
    assert np.allclose(deviation, [2e-3, 1e-3, 4e-3], rtol=DEVIATION_OF_4000, atol=0)


@pytest.mark.parametrize(
    ("preset", "grown", "reset"),
    [
        # Steps of the released code: grown between 3 000 and 20 000, reset every 3 000 but not at 3 000.
        ("released", (3100, 20000), [6001, 9001, 12001, 15001, 18001]),
        # Those of 3DGS, which Mip-Splatting keeps: grown between 500 and 15 000.
        ("paper", (600, 15000), [3001, 6001, 9001, 12001]),
    ],
)
def test_density_control_keeps_the_published_hours(preset, grown, reset, monkeypatch):
    options = GaussianOptions().with_overrides(find_method("dofgaussian").preset(preset)[1])
    steps, done = options.schedule.steps, {"grown": [], "reset": []}
    _, _, density = _setup(**asdict(options.density))
    now = []
    monkeypatch.setattr(density, "_grow_and_prune", lambda: done["grown"].append(now[-1]))
    monkeypatch.setattr(density, "_reset_opacity", lambda: done["reset"].append(now[-1]))
    for step in range(1, steps + 1):
        now.append(step)
        density.after_step(step, (step - 1) / steps)
    assert steps == 30_000 and done["grown"] == list(range(grown[0], grown[1] + 1, 100))
    # A sum of ten tenths isn't one, so a reset may come a step later.
    assert len(done["reset"]) == len(reset)
    assert all(found - expected in (0, 1) for found, expected in zip(done["reset"], reset, strict=True))


def test_the_opacity_below_which_a_gaussian_goes_falls_with_the_world_s_z():
    gaussians, _, density = _setup(count=4, prune_opacity=0.06, prune_depth_graded=True)
    with torch.no_grad():
        gaussians.parameters["means"][:, 2] = torch.tensor([0.0, 1.0, 2.0, 2.0])
        # Thresholds of 0.06 / (1, 2, 3, 3): above, below, above, below.
        gaussians.parameters["opacity_logits"][:] = torch.logit(torch.tensor([0.061, 0.029, 0.021, 0.019]))
    _record(gaussians, density, [])
    density.after_step(1, 0.0)
    assert gaussians.parameters["means"][:, 2].tolist() == [0.0, 2.0]


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
