"""Adam's steps on the Gaussians: sizes by its closed form, and states that are kept and brought back."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import cloud
from tolerances import FLOAT32_GRADIENT

from dofbench.training.gaussians.model import PARAMETERS, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions

RATES = RateOptions(
    means_lr=0.04, means_lr_final=0.01, sh_dc_lr=0.02, sh_rest_lr=0.03, opacity_lr=0.05, scale_lr=0.06, rotation_lr=0.07
)
OWN = {"log_scales": 0.06, "quaternions": 0.07, "opacity_logits": 0.05, "sh_dc": 0.02, "sh_rest": 0.03}


def _begun(extent: float = 3.0) -> tuple[Gaussians, GaussianOptimiser]:
    random = np.random.default_rng(0)
    gaussians = Gaussians.from_points(cloud(random.normal(size=(6, 3)), rgb=random.uniform(size=(6, 3))), 1)
    return gaussians, GaussianOptimiser(gaussians, RATES, extent)


def _step(
    gaussians: Gaussians, optimiser: GaussianOptimiser, seed: int, progress: float, cooldown: float = 1.0
) -> None:
    generator = torch.Generator().manual_seed(seed)
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.randn(parameter.shape, generator=generator)
    optimiser.step(progress, cooldown)


def _values(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    return {name: gaussians.parameters[name].detach().clone() for name in PARAMETERS}


@pytest.mark.parametrize(("progress", "means"), [(0.0, 0.04), (0.5, 0.02), (1.0, 0.01)])
@pytest.mark.parametrize("cooldown", [1.0, 0.25])
def test_a_first_step_is_the_rate_against_the_gradient(progress: float, means: float, cooldown: float) -> None:
    """Adam's first step has the size of its rate, whatever the gradient's: the bias corrections cancel its moments. The
    means' rate is in units of the scene's extent, 3, and falls exponentially."""
    gaussians, optimiser = _begun()
    before = _values(gaussians)
    _step(gaussians, optimiser, 1, progress, cooldown)
    after, generator = _values(gaussians), torch.Generator().manual_seed(1)
    for name in gaussians.parameters:
        sign = torch.randn(before[name].shape, generator=generator).sign()
        rate = cooldown * (3 * means if name == "means" else OWN[name])
        moved = ((before[name] - after[name]) * sign / rate).numpy()
        assert moved == pytest.approx(np.ones(moved.shape), rel=FLOAT32_GRADIENT), name


def test_training_goes_on_from_a_state_as_it_did() -> None:
    """Three steps, and the same three again from the state between, also after Gaussians came and went."""
    gaussians, optimiser = _begun()
    _step(gaussians, optimiser, 1, 0.1)
    state = optimiser.state()
    for seed in (2, 3):
        _step(gaussians, optimiser, seed, 0.2)
    expected = _values(gaussians)
    added = {name: value[:2] for name, value in expected.items()}
    optimiser.rebuild(torch.tensor([0, 2, 5]), added)
    _step(gaussians, optimiser, 4, 0.3)
    optimiser.restore(state)
    for seed in (2, 3):
        _step(gaussians, optimiser, seed, 0.2)
    for name, value in _values(gaussians).items():
        assert torch.equal(value, expected[name]), name


def test_a_state_is_a_copy() -> None:
    gaussians, optimiser = _begun()
    _step(gaussians, optimiser, 1, 0.1)
    kept, state = _values(gaussians), optimiser.state()
    _step(gaussians, optimiser, 2, 0.1)
    optimiser.restore(state)
    _step(gaussians, optimiser, 3, 0.1)  # must not change the state that it started from
    optimiser.restore(state)
    assert all(torch.equal(value, kept[name]) for name, value in _values(gaussians).items())


def test_what_stays_keeps_its_moments_and_what_is_new_has_none() -> None:
    """By the next step under no gradient: a new Gaussian doesn't move, an old one moves on."""
    gaussians, optimiser = _begun()
    _step(gaussians, optimiser, 1, 0.0)
    old = _values(gaussians)
    optimiser.rebuild(torch.tensor([1, 4]), {name: value[:3] for name, value in old.items()})
    before = _values(gaussians)
    for name, value in before.items():
        assert torch.equal(value, torch.cat([old[name][[1, 4]], old[name][:3]])), name
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.zeros_like(parameter)
    optimiser.step(0.0)
    for name, value in _values(gaussians).items():
        if value.numel():
            assert torch.equal(value[2:], before[name][2:]) and bool((value[:2] != before[name][:2]).all()), name


def test_discarded_gradients_move_nothing() -> None:
    gaussians, optimiser = _begun()
    before = _values(gaussians)
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimiser.discard_gradients()
    optimiser.step(0.0)
    assert all(torch.equal(value, before[name]) for name, value in _values(gaussians).items())
