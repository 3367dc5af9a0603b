"""Density control by sampling: copies look as the original, transparent Gaussians move, noise, and the cost."""

from __future__ import annotations

import math
from importlib import import_module

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import Recorder, cloud
from scipy.integrate import quad
from small_scene import cameras, training_set
from tolerances import DEVIATION_OF_4000, FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.training.gaussians.density import DensityOptions
from dofbench.training.gaussians.model import PARAMETERS, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions

splatting = import_module("dofbench.methods.3dgs.method")


@given(st.floats(0.01, 0.99), st.integers(1, 51))
def test_copies_together_look_as_the_one_that_they_were(opacity: float, copies: int) -> None:
    """One behind the other: the light that passes all is 1 - opacity in the middle, and the integral over the image, by
    quadrature along a line, is that of the one Gaussian."""
    each, smaller = (
        float(found)
        for found in splatting.shared_among(torch.tensor([opacity], dtype=torch.float64), torch.tensor([copies]))
    )
    assert (1 - each) ** copies == pytest.approx(1 - opacity, rel=FLOAT32_SCALAR)
    together, _ = quad(lambda t: 1 - (1 - each * math.exp(-t * t / 2)) ** copies, -12, 12, limit=200)
    assert smaller * together == pytest.approx(opacity * math.sqrt(2 * math.pi), rel=FLOAT32_SCALAR)


def test_opacities_of_0_and_1_are_shared_as_the_nearest_that_a_logit_has() -> None:
    """1e-6 from the ends: two copies of what is opaque but for that let 1e-3 each through."""
    each, smaller = splatting.shared_among(torch.tensor([0.0, 1.0], dtype=torch.float64), torch.tensor([2, 2]))
    assert each.tolist() == pytest.approx([5e-7, 1 - 1e-3], rel=FLOAT32_SCALAR)
    assert bool(torch.isfinite(smaller).all())


def setup(count: int = 40, rate: float = 0.0, **options) -> tuple[Gaussians, GaussianOptimiser, splatting.Relocation]:
    random = np.random.default_rng(3)
    points = cloud(random.normal(size=(count, 3)), rgb=random.uniform(size=(count, 3)))
    gaussians = Gaussians.from_points(points, 1)
    optimiser = GaussianOptimiser(gaussians, RateOptions(means_lr=max(rate, 1e-12), means_lr_final=1e-12), 1.0)
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimiser.step(0.0)
    density = DensityOptions(densify_from=0.0, densify_every=5, max_gaussians=options.pop("most", 10_000))
    relocation = splatting.Relocation(
        gaussians, optimiser, density, splatting.RelocationOptions(**options), 2.0, torch.Generator().manual_seed(0)
    )
    return gaussians, optimiser, relocation


def test_transparent_ones_move_to_opaque_ones() -> None:
    gaussians, optimiser, relocation = setup(noise_lr=0.0, most=40)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"][:] = -30.0
        gaussians.parameters["opacity_logits"][7] = math.log(0.9 / 0.1)
    before = {name: value.detach().clone() for name, value in gaussians.parameters.items()}
    assert not relocation.after_step(4, 0.1) and relocation.after_step(5, 0.1)
    assert len(gaussians) == 40
    after = {name: value.detach() for name, value in gaussians.parameters.items()}
    assert bool((after["means"] == before["means"][7]).all())
    each, smaller = splatting.shared_among(torch.tensor([0.9]), torch.tensor([40]))
    assert torch.sigmoid(after["opacity_logits"]).unique().tolist() == pytest.approx(each.tolist(), rel=FLOAT32_VALUE)
    grown = (after["log_scales"] - before["log_scales"][7]).exp()
    assert grown.unique().tolist() == pytest.approx(smaller.tolist() * len(grown.unique()), rel=FLOAT32_VALUE)
    assert all(not state.moments.exp_avg.any() for state in optimiser.state().values())


def test_more_are_added_up_to_the_limit_and_moments_of_the_others_stay() -> None:
    gaussians, optimiser, relocation = setup(noise_lr=0.0, most=43)
    counts = []
    for step in (5, 10, 15):
        assert relocation.after_step(step, 0.1)
        counts.append(len(gaussians))
    assert counts == [42, 43, 43]
    first = optimiser.state()["means"].moments.exp_avg[:40]
    assert 0 < int((first != 0).any(dim=1).sum()) < 40  # those that were copied begin again
    assert not relocation.after_step(20, 0.6)  # behind densify_until


def test_what_is_due_in_a_trial_happens_after_it() -> None:
    gaussians, _, relocation = setup(noise_lr=0.0)
    with relocation.pace.rest():
        assert not relocation.after_step(5, 0.1) and len(gaussians) == 40
    assert relocation.after_step(6, 0.1) and len(gaussians) == 42


def test_noise_has_each_gaussians_covariance_and_spares_opaque_ones() -> None:
    gaussians, optimiser, relocation = setup(count=4000, rate=1e-3, noise_lr=100.0)
    scales = torch.tensor([0.3, 0.1, 0.02])
    turn = torch.tensor([math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)])  # 45 degrees about z
    with torch.no_grad():
        gaussians.parameters["log_scales"][:] = scales.log()
        gaussians.parameters["quaternions"][:] = turn
        gaussians.parameters["opacity_logits"][:] = -30.0
        gaussians.parameters["opacity_logits"][0] = 3.0
    before = gaussians.parameters["means"].detach().clone()
    relocation.after_step(1, 0.1)
    moved = (gaussians.parameters["means"].detach() - before).double()
    assert optimiser.means_rate == pytest.approx(1e-3)
    assert not moved[0].any()
    # Noise is the covariance times a standard normal, so its own covariance is the square of it.
    half = math.sqrt(0.5)
    axes = np.array([[half, -half, 0], [half, half, 0], [0, 0, 1]])
    covariance = axes @ np.diag(scales.double().numpy() ** 2) @ axes.T
    transparent = 1 / (1 + math.exp(-100 * 0.005))
    expected = (100.0 * 1e-3 * transparent) ** 2 * covariance @ covariance
    found = np.cov(moved[1:].numpy().T)
    np.testing.assert_allclose(found, expected, atol=2 * DEVIATION_OF_4000 * expected.max())


def test_the_cost_charges_opacity_and_scale() -> None:
    gaussians, _, relocation = setup(opacity_cost=0.5, scale_cost=3.0)
    opacity = 1 / (1 + np.exp(-gaussians.parameters["opacity_logits"].detach().double().numpy()))
    scales = np.exp(gaussians.parameters["log_scales"].detach().double().numpy())
    expected = 0.5 * opacity.mean() + 3 * scales.mean() / 2.0
    assert float(relocation.cost().detach()) == pytest.approx(expected, rel=FLOAT32_VALUE)
    relocation.cost().backward()
    assert bool((gaussians.parameters["log_scales"].grad > 0).all())


def test_3dgs_trains_with_either_control() -> None:
    for mcmc in (False, True):
        # The three cameras are close together, and so is the scene's extent small against its Gaussians.
        options = {
            "steps": 90,
            "sh_degree": 1,
            "densify_from": 0.1,
            "densify_every": 20,
            "prune_scale": 10,
            "mcmc": mcmc,
        }
        method = splatting.Splatting(options, 0, "cpu")
        first = method.OPTIONS.of(**options).first_gaussians(training_set().points, "cpu").parameters
        assert float(torch.sigmoid(first["opacity_logits"].detach()[0])) == pytest.approx(0.5 if mcmc else 0.1)
        outcome = method.fit(training_set(), Budget(steps=90), Recorder())
        assert outcome.status is Status.OK
        assert len(method.gaussians) != 250 and method.render(cameras()[0], None).image.max() > 0.3
        assert set(method.gaussians.parameters) == set(PARAMETERS)
