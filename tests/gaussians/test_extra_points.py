"""Points added once: where, with which colours, when, and what begins anew."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from made_up import Recorder, cloud
from small_scene import training_set
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.methods.cocogaussian.method import CoCoGaussian
from dofbench.methods.deblurring3dgs.method import Deblurring3DGS
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.extra_points import ExtraOptions, GrowingOnce, draw_between, neighbour_distances
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions


def grid() -> torch.Tensor:
    """A thousand places, one unit apart."""
    return torch.stack(torch.meshgrid(*[torch.arange(10.0)] * 3, indexing="ij"), 3).reshape(-1, 3)


def test_points_fill_the_box_without_its_outermost_ones_and_stay_near_others() -> None:
    means = torch.cat([grid(), torch.tensor([[900.0, 900.0, 900.0]])])
    options = ExtraOptions(extra_points=5000, extra_within=0.5)
    places, _ = draw_between(means, torch.zeros(len(means), 3), options, torch.Generator().manual_seed(0))
    assert float(places.min()) >= 0 and float(places.max()) <= 9  # not as far as the one at 900
    nearest = (places[:, None] - means).norm(dim=2).min(dim=1).values
    # Within half a spacing of a corner of its cell: pi / 6 of all.
    assert float(nearest.max()) < 0.5
    expected, deviation = math.pi / 6, math.sqrt(math.pi / 6 * (1 - math.pi / 6) / 5000)
    assert abs(len(places) / 5000 - expected) < 4 * deviation


def test_a_colour_is_the_mean_of_the_four_nearest_by_distance() -> None:
    random = np.random.default_rng(1)
    means = torch.from_numpy(random.uniform(size=(200, 3))).float()
    colours = torch.from_numpy(random.uniform(size=(200, 3))).float()
    options = ExtraOptions(extra_points=50, extra_within=1e9)
    places, found = draw_between(means, colours, options, torch.Generator().manual_seed(0))
    assert len(places) == 50
    for place, colour in zip(places, found, strict=True):
        distance = (means - place).norm(dim=1).double()
        four = distance.argsort()[:4]
        expected = (distance[four, None] * colours[four]).sum(dim=0) / distance[four].sum()
        assert colour.tolist() == pytest.approx(expected.tolist(), rel=FLOAT32_VALUE)


def test_the_three_nearest_others() -> None:
    means = torch.from_numpy(np.random.default_rng(2).normal(size=(50, 3))).float().requires_grad_()
    distances, nearest = neighbour_distances(means)
    every = torch.cdist(means.detach().double(), means.detach().double())
    assert torch.equal(nearest, every.argsort(dim=1)[:, 1:4])
    expected = every.sort(dim=1).values[:, 1:4]
    np.testing.assert_allclose(distances.numpy(), expected.numpy(), rtol=FLOAT32_VALUE)


def control(points: int = 40) -> tuple[Gaussians, GaussianOptimiser, GrowingOnce]:
    random = np.random.default_rng(3)
    gaussians = Gaussians.from_points(cloud(random.normal(size=(100, 3)), rgb=random.uniform(size=(100, 3))), 1)
    optimiser = GaussianOptimiser(gaussians, RateOptions(), 1.0)
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimiser.step(0.0)
    extra = ExtraOptions(extra_points=points, extra_at=0.2, extra_within=1e9)
    density = DensityOptions(densify_from=0.9, reset_every=0.0)
    return (
        gaussians,
        optimiser,
        GrowingOnce(gaussians, optimiser, density, extra, 1.0, torch.Generator().manual_seed(0)),
    )


def test_points_come_once_and_shapes_and_moments_begin_anew() -> None:
    gaussians, optimiser, density = control()
    before = gaussians.parameters["means"].detach().clone()
    assert not density.after_step(1, 0.19) and len(gaussians) == 100
    with density.pace.rest():
        assert not density.after_step(2, 0.2)
    kept = density.state()
    assert density.after_step(3, 0.2) and len(gaussians) == 140
    assert torch.equal(gaussians.parameters["means"][:100], before)
    found = {name: value.detach() for name, value in gaussians.parameters.items()}
    assert torch.sigmoid(found["opacity_logits"]).unique().tolist() == pytest.approx([0.1])
    assert found["quaternions"].unique(dim=0).tolist() == [[1, 0, 0, 0]]
    distance = torch.cdist(found["means"].double(), found["means"].double()).sort(dim=1).values[:, 1:4]
    expected = distance.square().mean(dim=1).sqrt()
    assert found["log_scales"][:, 0].exp().tolist() == pytest.approx(expected.tolist(), rel=FLOAT32_VALUE)
    assert all(not state.moments.exp_avg.any() for state in optimiser.state().values())
    assert not density.after_step(4, 0.3) and len(gaussians) == 140
    assert density.state()[3] and not kept[3]
    density.restore(tuple(torch.ones_like(one) if isinstance(one, torch.Tensor) else one for one in kept))
    sums, visits, _, added = density.state()
    assert not added and bool((sums == 1).all()) and bool((visits == 1).all())


def test_none_are_added_unless_asked() -> None:
    gaussians, _, density = control(points=0)
    assert not density.after_step(1, 0.5) and len(gaussians) == 100


@pytest.mark.parametrize("kind", [Deblurring3DGS, CoCoGaussian])
def test_a_training_goes_on_with_them(kind) -> None:
    options = {"steps": 60, "sh_degree": 1, "densify_from": 0.9, "reset_every": 0.0, "extra_points": 200}
    method = kind(options, 0, "cpu")
    outcome = method.fit(training_set(), Budget(steps=60), Recorder())
    assert outcome.status is Status.OK and len(method.gaussians) > 250


def test_beside_the_added_points_density_is_controlled_as_without_them() -> None:
    """Step and share of the training reach the control that they are meant for."""

    def grown(kind: type) -> list[int]:
        gaussians, optimiser, _ = control()
        options = DensityOptions(densify_from=0.1, densify_every=10, reset_every=0.0)
        extra = (ExtraOptions(extra_points=0),) if kind is GrowingOnce else ()
        density = kind(gaussians, optimiser, options, *extra, 1.0, torch.Generator().manual_seed(0))
        counts = []
        for step in range(1, 31):
            seen = ViewStatistics(
                visible=torch.ones(len(gaussians), dtype=torch.bool), radii=torch.ones(len(gaussians))
            )
            seen.grad_2d = seen.abs_grad_2d = torch.ones(len(gaussians), 2)
            density.record(seen, 48, 36)
            density.after_step(step, step / 30)
            counts.append(len(gaussians))
        return counts

    counts = grown(GrowingOnce)
    assert counts == grown(DensityControl) and counts[-1] > counts[0] == 100
