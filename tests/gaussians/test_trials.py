"""What training finds out for itself: on photographs through a lens, and on sharp ones."""

import dataclasses

import numpy as np
import pytest
import torch
from small_scene import HEIGHT, WIDTH, Recorder, options, training_set

from dofbench.contracts import Budget, TrainingSet
from dofbench.defocus import defocus_numpy
from dofbench.errors import InputError, Status
from dofbench.gaussians.options import TrainerOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.gaussians.trials import Trials
from dofbench.lens import PhysicalLens

OPEN = {"lens_trials": "lens", "lens_trials_at": 0.4, "lens_trials_steps": 0.06, "lens_activation": "ends",
        "lens_update": "dense", "lens_lr": 1e-2, "lens_lr_final": 1e-2, "adaptation": "off", "steps": 240}


def _photographs(aperture, foci):
    """The small scene through lenses (px x scene unit; scene units), blurred by the depth of its points."""
    sharp = training_set()
    views = []
    for view, focus in zip(sharp.views, foci, strict=True):
        depth = np.full((HEIGHT, WIDTH), 6.0, np.float32)
        xy, z = view.camera.project(sharp.points.xyz)
        for i in np.argsort(-z):
            column, row = int(xy[i, 0]), int(xy[i, 1])
            depth[max(row - 2, 0):row + 3, max(column - 2, 0):column + 3] = z[i]
        image, _ = defocus_numpy(view.image, depth, PhysicalLens(aperture, 1 / focus, WIDTH))
        views.append(dataclasses.replace(view, image=np.clip(image, 0, 1)))
    return TrainingSet(tuple(views), sharp.points)


def _fit(photographs, **overrides):
    trainer = Trainer(photographs, options(**{**OPEN, **overrides}), 0)
    outcome = trainer.fit(Budget(), Recorder())
    assert outcome.status is Status.OK and outcome.steps == 240
    return trainer, outcome


def test_a_lens_that_explains_the_photographs_stays():
    trainer, outcome = _fit(_photographs(20.0, (3.0, 6.0, 3.0)))
    [decision] = outcome.decisions
    assert decision.stage == "lens" and decision.runs and trainer.options.lens
    assert "held-back pixels" in decision.reason


def test_a_lens_that_sharp_photographs_do_without_is_left_out():
    trainer, outcome = _fit(training_set(), lens_init_aperture=0.05)
    [decision] = outcome.decisions
    assert decision.stage == "lens" and not decision.runs
    assert not trainer.options.lens and trainer.lens_estimates() is None


def test_photographs_of_one_lens_share_it_and_those_of_several_do_not():
    one, told = _fit(_photographs(20.0, (3.0, 3.0, 3.0)), lens_trials="share", lens_init_aperture=1.0)
    assert not told.decisions[0].runs and one.options.lens_per == "scene"
    several, told = _fit(_photographs(20.0, (3.0, 6.0, 3.0)), lens_trials="share", lens_init_aperture=1.0)
    assert several.options.lens_per != "scene", told.decisions


def test_a_trial_that_was_lost_leaves_nothing_behind():
    """Training on from a snapshot takes the same steps, whatever was tried in between."""
    ends = []
    for detour in (False, True):
        trainer = Trainer(training_set(), options(**OPEN), 0)
        trainer._photographs = trainer._all_photographs()
        trainer.train(0, 40, 240, 0.0)
        start = trainer.snapshot()
        if detour:
            trainer.revise({"lens": False, "adaptation": "off"})
            trainer.train(40, 45, 240, 0.0)  # density control changes the number of Gaussians on the way
        trainer.restore(start)
        trainer.train(40, 45, 240, 0.0)
        ends.append({name: value.detach().clone() for name, value in trainer.gaussians.parameters.items()})
    assert all(torch.equal(ends[0][name], ends[1][name]) for name in ends[0])


def test_tiles_are_held_back_until_the_trials_are_over():
    trainer = Trainer(training_set(), options(**OPEN), 0)
    assert trainer._view(0, 1).held_back is not None
    trainer.fit(Budget(), Recorder())
    assert trainer._view(0, 1).held_back is None


def test_the_length_of_a_trial_is_a_share_of_the_training_and_shows_every_photograph_twice():
    trials = Trials(None, TrainerOptions(lens_trials="lens"))
    assert trials.length(5000, 17) == 150
    assert trials.length(2000, 50) == 100
    assert trials.length(600, 50) == 36  # but no more than 6 % of it


def test_an_unknown_question_is_named():
    with pytest.raises(InputError, match="lens_trials.*'colour'"):
        TrainerOptions(lens_trials="lens,colour")


