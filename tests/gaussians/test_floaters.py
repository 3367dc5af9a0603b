"""Gaussians near one view that no other sees are removed."""

import torch
from made_up import Recorder
from small_scene import cameras, options, training_set

from dofbench.core.budget import Budget
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions
from dofbench.training.gaussians.trainer import Trainer

# The cameras are at x -0.3, 0.3 and 0, and the nearest points 3 away: the first is a floater before the first camera,
# the second as near, but in the view of two cameras, the third as far as the points, and the fourth behind all cameras.
_PLACES = [(-0.5, 0.0, 0.5), (0.0, 0.0, 1.0), (-2.1, 0.0, 3.0), (0.0, 0.0, -1.0)]
_SEEN = [1, 3, 1, 0]


def _control(near: float) -> tuple[Gaussians, DensityControl]:
    gaussians = Gaussians.from_points(training_set().points, 0)
    with torch.no_grad():
        gaussians.parameters["means"][: len(_PLACES)] = torch.tensor(_PLACES)
    optimiser = GaussianOptimiser(gaussians, RateOptions(), 1.0)
    chosen = DensityOptions(densify_every=10, densify_until=0.5, prune_near=near, reset_every=0.0)
    control = DensityControl(gaussians, optimiser, chosen, 1.0, torch.Generator())
    control.cameras, control.nearest = cameras(), 3.0
    return gaussians, control


def test_the_places_are_seen_by_as_many_views_as_said() -> None:
    gaussians, control = _control(0.7)
    each = [gaussians.floaters([camera], 10.0)[: len(_PLACES)] for camera in control.cameras]
    assert torch.stack(each).sum(dim=0).tolist() == _SEEN


def test_only_what_is_near_one_view_and_seen_by_no_other_is_removed() -> None:
    for progress in (0.0, 0.9):  # while no Gaussians are added, too
        gaussians, control = _control(0.7)
        rest = gaussians.parameters["means"][1:].detach().clone()
        assert not control.after_step(9, progress)  # not yet due
        assert control.after_step(10, progress)
        assert torch.equal(gaussians.parameters["means"], rest)
        assert not control.after_step(20, progress)


def test_by_default_all_stay() -> None:
    gaussians, control = _control(0.0)
    assert not control.after_step(10, 0.9) and len(gaussians) == 250


def test_a_training_ends_without_floaters() -> None:
    trainer = Trainer(training_set(), options(steps=60, prune_near=0.9), 0)
    with torch.no_grad():
        trainer.gaussians.parameters["means"][0] = torch.tensor(_PLACES[0])
    assert trainer.gaussians.floaters(cameras(), 2.7)[0]
    trainer.fit(Budget(), Recorder())
    assert len(trainer.gaussians) > 200 and not trainer.gaussians.floaters(cameras(), 2.5).any()
