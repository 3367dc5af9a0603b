import math
from dataclasses import asdict
from importlib import import_module

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import DEVIATION_OF_4000, FLOAT32_GRADIENT, FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange
from dofbench.methods.cards import find_method
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians.density import DensityControl, DensityOptions, rotate
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import PARAMETERS, Gaussians, near_plane, scene_extent
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions

splatting = import_module("dofbench.methods.3dgs.method")


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


def test_one_as_large_as_the_bound_is_cloned():
    """3DGS splits what is larger than the share of the extent, and clones the rest."""
    gaussians, _, density = _setup(dense_share=0.25)
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = math.log(0.25)
    _record(gaussians, density, [1])
    assert density.after_step(1, 0.0)
    assert bool((gaussians.parameters["log_scales"].detach() == math.log(0.25)).all()) and len(gaussians) == 13


@pytest.mark.parametrize(("progress", "left"), [(0.1, {0.05, 0.2, 0.4 / 1.6, 0.11 / 1.6}), (0.3, {0.05, 0.11 / 1.6})])
def test_3dgs_removes_what_is_huge_after_the_first_reset(progress: float, left: set[float]) -> None:
    """Of the scene's extent: 0.05 is small, 0.2 huge, 0.4 is split into two that are still huge, 0.11 into two that
    aren't."""
    gaussians, optimiser, _ = _setup(count=4)
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = torch.tensor([0.05, 0.2, 0.4, 0.11]).log()[:, None]
    options = splatting.PrunedDensity(densify_from=0.0, densify_every=1, reset_every=0.2, prune_scale=0.1)
    density = DensityControl(gaussians, optimiser, options, 1.0, torch.Generator().manual_seed(0))
    density._next_reset = 1.0  # opacities stay
    _record(gaussians, density, [2, 3])
    assert density.after_step(1, progress)
    found = gaussians.parameters["log_scales"].detach().exp().max(dim=1).values
    assert sorted(set(found.tolist())) == pytest.approx(sorted(left), rel=FLOAT32_SCALAR)


def test_moments_follow_their_gaussians_and_new_ones_start_at_zero():
    gaussians, optimiser, density = _setup()
    _record(gaussians, density, [2])
    density.after_step(1, 0.0)
    for name, state in optimiser.state().items():
        parameter = gaussians.parameters[name]
        assert torch.equal(state.value, parameter.detach())
        for moment in (state.moments.exp_avg, state.moments.exp_avg_sq):
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
    monkeypatch.setattr(density, "_grow_and_prune", lambda largest: done["grown"].append(now[-1]))
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


def test_a_gradient_at_the_threshold_grows_and_an_opacity_at_the_threshold_stays():
    """3DGS grows at 2e-4 or more, and removes below its least opacity: at these very values, which are whole powers of
    two here, nothing is rounded."""
    gaussians, _, density = _setup(grow_gradient=0.25, prune_opacity=0.5)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"][:] = 0.0
        gaussians.parameters["log_scales"][:] = math.log(1e-4)
    gradient = torch.zeros(12, 2)
    gradient[3, 0], gradient[4, 1] = 0.25 / 5, 0.2499 / 5  # times half of 10 pixels
    _see(density, gradient)
    density.after_step(1, 0.0)
    assert len(gaussians) == 13


def test_the_gradient_is_the_mean_over_visits_in_units_of_half_the_image():
    def grown(width, height, gradient, seen):
        gaussians, _, density = _setup(grow_gradient=0.9)
        with torch.no_grad():
            gaussians.parameters["log_scales"][:] = math.log(1e-4)
        for one, visible in zip(gradient, seen, strict=True):
            both = torch.zeros(12, 2)
            both[7] = torch.tensor(one)
            statistics = ViewStatistics(visible=torch.full((12,), visible), grad_2d=both)
            density.record(statistics, width, height)
        density.after_step(1, 0.0)
        return len(gaussians) - 12

    # Half of 8 times 3 and half of 6 times 4 are 12 and 12: 17 by Pythagoras, over the views that see it.
    assert grown(8, 6, [(0.21, 0.0)], [True]) == 0 and grown(8, 6, [(0.24, 0.0)], [True]) == 1
    assert grown(8, 6, [(0.0, 0.29)], [True]) == 0 and grown(8, 6, [(0.0, 0.31)], [True]) == 1
    assert grown(8, 6, [(0.15, 0.2)], [True]) == 0 and grown(8, 6, [(0.17, 0.22)], [True]) == 1
    assert grown(8, 6, [(0.3, 0.0), (0.1, 0.0)], [True, True]) == 0
    assert grown(8, 6, [(0.3, 0.0), (0.0, 0.0)], [True, False]) == 1


def test_when_opacities_are_reset():
    """Every tenth of the training from the first one on, between the beginning and the end of densification."""
    gaussians, _, density = _setup(reset_every=0.1, densify_from=0.15, densify_until=0.45, densify_every=1000)
    logits, reset = gaussians.parameters["opacity_logits"], []
    for step in range(1, 100):
        with torch.no_grad():
            logits[:] = 3.0
        density.after_step(step, step / 100)
        reset += [step] if float(logits.detach().max()) < 3 else []
    assert len(reset) == 3 and all(abs(step - due) <= 1 for step, due in zip(reset, (20, 30, 40), strict=True))
    expected = math.log(0.01 / 0.99)
    with torch.no_grad():
        logits[:] = torch.tensor([3.0, -6.0]).repeat(6)
    density._reset_opacity()
    assert np.allclose(logits.detach().numpy()[:2], [expected, -6.0], rtol=FLOAT32_VALUE)


def test_a_clone_that_shares_lets_as_much_light_through():
    gaussians, _, density = _setup(clone_opacity="share")
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = math.log(1e-4)
        gaussians.parameters["opacity_logits"][:] = torch.linspace(-3, 3, 12)
    before = torch.sigmoid(gaussians.parameters["opacity_logits"].detach().clone())
    _record(gaussians, density, [2, 9])
    density.after_step(1, 0.0)
    after = torch.sigmoid(gaussians.parameters["opacity_logits"].detach())
    for index, clone in ((2, 12), (9, 13)):
        through = (1 - float(after[index])) * (1 - float(after[clone]))
        assert through == pytest.approx(1 - float(before[index]), rel=FLOAT32_GRADIENT)
    others = [index for index in range(12) if index not in (2, 9)]
    assert np.allclose(after[others].numpy(), before[others].numpy(), rtol=FLOAT32_VALUE)


def test_children_are_drawn_from_their_parent():
    """Of 4 000 children mean and covariance are those of the parent, within five standard errors, and all else is
    inherited but for the size."""
    from scipy.spatial.transform import Rotation

    gaussians, _, density = _setup(count=4)
    parent = {
        name: value.detach()[:1].repeat(2000, *[1] * (value.ndim - 1)) for name, value in gaussians.parameters.items()
    }
    parent["log_scales"][:] = torch.tensor([0.5, -1.0, -2.0])
    parent["quaternions"][:] = torch.tensor([0.7, 0.2, -0.4, 0.3])
    children = density._children(parent)
    axes = Rotation.from_quat([0.2, -0.4, 0.3, 0.7]).as_matrix()
    local = (children["means"] - parent["means"][0]).numpy() @ axes / np.exp([0.5, -1.0, -2.0])
    error = 5 / math.sqrt(len(local))
    assert local.shape == (4000, 3) and np.abs(local.mean(axis=0)).max() < error
    assert np.abs(np.cov(local.T) - np.eye(3)).max() < error * math.sqrt(2)
    assert np.allclose(children["log_scales"].exp().numpy() * 1.6, np.exp([0.5, -1.0, -2.0]), rtol=FLOAT32_VALUE)
    for name in ("quaternions", "opacity_logits", "sh_dc", "sh_rest"):
        assert torch.equal(children[name][:2000], parent[name]) and torch.equal(children[name][2000:], parent[name])


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


def test_the_filter_counts_views_behind_the_near_plane_and_up_to_15_per_cent_beside_the_image():
    """3DGS's near plane is at 0.2; the image is 20 by 10 pixels, and a Gaussian just outside a bound gets the largest
    size of the others, that of the one at 9."""
    camera, beside = frontal(20, 10, 10.0), []
    for share, seen in ((1.14, True), (1.16, False), (-0.14, True), (-0.16, False)):
        beside += [((20 * share - 10) / 10 * 4, 0.0, 4.0, seen), (0.0, (10 * share - 5) / 10 * 4, 4.0, seen)]
    places = [(0.0, 0.0, 9.0, True), (0.0, 0.0, 0.21, True), (0.0, 0.0, 0.19, False), *beside]
    gaussians = Gaussians.from_points(cloud([place[:3] for place in places]), 0)
    gaussians.update_filter_3d([camera])
    expected = [(z if seen else 9.0) / 10 * math.sqrt(0.2) for *_, z, seen in places]
    assert np.allclose(gaussians.filter_3d.numpy(), expected, rtol=FLOAT32_VALUE)


@pytest.mark.parametrize(("share", "near"), [(0.0, 0.2), (0.5, 2.0)])
def test_the_near_plane_is_a_share_of_the_nearest_depth(share, near):
    """The nearest points are at 4."""
    bounds = DisparityRange(0.01, 0.25)
    assert near_plane(bounds, share) == pytest.approx(near)
    assert near_plane(DisparityRange(1.0, 100.0)) == pytest.approx(0.0025), "a macro scene in metres"


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


def test_extent_of_a_single_camera_is_one():
    assert scene_extent([frontal(2, 2, 1.0)]) == 1.0
