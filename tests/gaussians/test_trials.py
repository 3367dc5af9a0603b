"""Trials while training, on photographs through a lens and on sharp ones."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from made_up import Recorder
from scipy.ndimage import gaussian_filter
from small_scene import options, training_set
from tolerances import ONE_STEP

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.core.image_files.exif import Exif
from dofbench.training.common.held_out import HeldOutScores
from dofbench.training.common.reproduction import Reproduction, reproduction
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.trainer import Trainer
from dofbench.training.gaussians.trials import Trials, questions

OPEN = {
    "lens_trials": "lens",
    "lens_trials_at": 0.4,
    "lens_trials_steps": 0.06,
    "lens_activation": "ends",
    "lens_update": "dense",
    "lens_lr": 1e-2,
    "lens_lr_final": 1e-2,
    "adaptation": "off",
    "steps": 240,
}


class Scripted:
    """A fake trainer with a given score for each setting: dB on held-back pixels by the option that was changed."""

    count = 20
    seconds = 1.0  # of a trial
    passed = 0.0

    def __init__(self, dB, circle=4.0, apart=5.0, exif=(None,), noise=0.01):
        views = [dataclasses.replace(training_set().views[0], exif=one) for one in exif]
        self.views = [views[i % len(views)] for i in range(self.count)]
        self._dB, self._circle, self._apart, self._noise = dB, circle, apart, noise
        self.changes, self.log = {}, []

    def snapshot(self):
        return dict(self.changes)

    def restore(self, snapshot):
        self.changes = dict(snapshot)

    def revise(self, changes):
        self.changes.update(changes)

    def train(self, step, count, total, progress, tell, left):
        if left() < self.seconds:
            return False
        if left() < math.inf:
            self.passed += self.seconds
        self.log.append((step, count))
        tell(0, count)
        return True

    def held_out_scores(self, share):
        key = self.changes.get("lens_model") or (
            "no lens" if self.changes.get("lens") is False else self.changes.get("lens_per", "view")
        )
        easy = np.linspace(20, 40, self.count)  # views differ far more than settings do
        noise = np.random.default_rng(len(self.log)).normal(size=self.count)
        noise = self._noise * (noise - noise.mean())
        return HeldOutScores(0.0, 0.0, {str(i): (value, 0.0) for i, value in enumerate(easy + self._dB[key] + noise)})

    def widest_circle(self):
        return self._circle

    def foci_apart(self):
        return self._apart

    shown = Reproduction(40.0, 0.0)

    def reproduction(self):
        return self.shown


def _decided(trainer, asked="lens,share,model"):
    trials = Trials(trainer, GaussianOptions.of(lens_trials=asked, lens_trials_steps=0.03))
    told = []
    step, decisions = trials.decide(400, 1000, 0.4, lambda *words: told.append(words))
    assert [of for _, _, of in told] == [40] * len(trainer.log) and told[0][0] == "trial: the current setting"
    assert step == 440 and not trials.open and set(trainer.log) == {(400, 40)}
    assert all("dB" in decision.reason for decision in decisions)
    return trainer.changes, {decision.stage: decision.runs for decision in decisions}


GOOD = {"view": 1.0, "no lens": 0.0, "aperture": 0.5, "exif": 0.5, "scene": -1.0, "samples": 0.6}


@pytest.mark.parametrize(
    ("gain", "circle", "runs"),
    [
        (0.008, 0.8, False),  # no gain, and hardly any blur
        (0.008, 9.0, False),  # nor with wide circles
        (-0.02, 1.2, False),
        (0.03, 0.8, True),  # a small gain, but significant
        (-0.4, 9.0, False),  # predicts the photographs worse
        (0.30, 0.8, True),
        (0.30, 0.2, False),  # circles of confusion too small for a lens, whatever the gain
    ],
)
def test_when_a_lens_is_left_out(gain, circle, runs):
    changes, decided = _decided(Scripted({**GOOD, "view": gain}, circle=circle), "lens")
    assert decided == {"lens": runs} and changes.get("lens", True) is runs


def test_a_small_lens_that_may_explain_something_by_chance_is_left_out():
    _, decided = _decided(Scripted({**GOOD, "view": 0.03}, circle=0.8, noise=0.2), "lens")
    assert decided == {"lens": False}


@pytest.mark.parametrize(
    ("shown", "asked"),
    [
        (Reproduction(25.1, -2.9), True),
        (Reproduction(24.9, 0.0), False),  # not reproduced
        (Reproduction(30.0, -3.1), False),  # by blurrier renderings
    ],
)
def test_nothing_is_asked_about_a_lens_before_the_scene_stands(shown, asked):
    trainer = Scripted({**GOOD, "view": -0.5})
    trainer.shown = shown
    trials = Trials(trainer, GaussianOptions.of(lens_trials="lens,share,model", lens_trials_from=25.0))
    step, decisions = trials.decide(400, 1000, 0.4)
    assert step > 400 and not trials.open
    if asked:
        assert not decisions[0].runs and "lens gain" in decisions[0].figures
        return
    assert trainer.changes == {} and len(trainer.log) == 1, "training goes on as it was"
    (decision,) = decisions
    assert (
        decision.stage == "lens"
        and decision.runs
        and decision.figures
        == {
            "reproduced": shown.psnr,
            "detail": shown.detail,
        }
    )


def test_reproduction_sees_errors_and_blur_but_no_masked_pixel():
    view = training_set().views[0]
    left = np.broadcast_to(np.arange(view.camera.width) < 8, view.image.shape[:2])
    same = reproduction([view], lambda _: view.image)
    assert same.detail == 0
    wrong = np.where(left[..., None], view.image, 1 - view.image)
    assert reproduction([view], lambda _: wrong).psnr < same.psnr - 20
    assert reproduction([dataclasses.replace(view, mask=left)], lambda _: wrong).psnr == same.psnr
    assert reproduction([view], lambda _: gaussian_filter(view.image, (3, 3, 0))).detail < -3


def test_without_a_lens_nothing_else_is_asked():
    changes, decided = _decided(Scripted({**GOOD, "view": 0.0}, circle=0.5))
    assert decided == {"lens": False} and changes == {"lens": False, "adaptation": "off"}


def test_one_aperture_that_costs_nothing_is_shared():
    changes, decided = _decided(Scripted({**GOOD, "aperture": 0.98}), "share")
    assert decided == {"lens_per_view": False} and changes == {"lens_per": "aperture"}


def test_what_costs_less_than_it_can_be_measured_by_is_shared():
    changes, _ = _decided(Scripted({**GOOD, "aperture": 0.8}, noise=1.5), "share")
    assert changes == {"lens_per": "aperture"}


def test_one_lens_is_tried_only_where_the_foci_are_alike():
    alike = {**GOOD, "scene": 1.1}
    assert _decided(Scripted(alike, apart=0.4), "share")[0] == {"lens_per": "scene"}
    assert _decided(Scripted(alike, apart=3.0), "share")[0] == {}


def test_f_numbers_say_how_apertures_are_shared():
    changes, _ = _decided(Scripted({**GOOD, "exif": 1.0}, exif=(Exif(f_number=4.0),)), "share")
    assert changes == {"lens_per": "exif"}


def test_photographs_at_several_f_numbers_are_not_one_lens():
    alike = {**GOOD, "scene": 1.1, "exif": 1.0}
    same, several = (Exif(f_number=4.0),), (Exif(f_number=4.0), Exif(f_number=11.0))
    assert _decided(Scripted(alike, apart=0.4, exif=same), "share")[0] == {"lens_per": "scene"}
    assert _decided(Scripted(alike, apart=0.4, exif=several), "share")[0] == {"lens_per": "exif"}
    some = (Exif(f_number=4.0), None)  # if some f-numbers are unknown, nothing follows for all photographs
    assert _decided(Scripted(alike, apart=0.4, exif=some), "share")[0] == {"lens_per": "scene"}


def test_another_forward_model_must_be_better_for_sure():
    better = {**GOOD, "samples": 1.4}
    changes, decided = _decided(Scripted(better), "model")
    assert decided == {"lens_samples": True}
    assert changes["lens_model"] == "samples" and changes["lens_rings_from"] == 0.8
    assert _decided(Scripted(better, noise=3.0), "model")[0] == {}


@pytest.mark.slow
def test_training_goes_on_without_the_lens_that_sharp_photographs_do_without():
    trainer = Trainer(training_set(), options(**OPEN, lens_init_aperture=0.05), 0)
    outcome = trainer.fit(Budget(), Recorder())
    [decision] = outcome.decisions
    assert outcome.status is Status.OK and outcome.steps == 240
    assert decision.stage == "lens" and not decision.runs
    assert not trainer.options.lens.lens and trainer.lens_estimates() is None


def _walk(trainer, first, last):
    for step in range(first, last):
        trainer._next(step, step / 240)


def test_density_control_rests_during_a_trial_and_goes_on_afterwards():
    trainer = Trainer(training_set(), options(**OPEN), 0)
    trainer._scaled = trainer._scale_views()
    trainer.train(0, 65, 240, 0.0)  # densify_every is 20
    assert len(trainer.gaussians) == len(training_set().points)
    _walk(trainer, 65, 85)
    assert len(trainer.gaussians) != len(training_set().points)


def test_a_trial_that_was_lost_leaves_nothing_behind():
    """Training on from a snapshot takes the same steps, whatever was tried in between."""
    ends = []
    for detour in (False, True):
        trainer = Trainer(training_set(), options(**OPEN), 0)
        trainer._scaled = trainer._scale_views()
        trainer.train(0, 40, 240, 0.0)
        start = trainer.snapshot()
        if detour:
            trainer.revise({"lens": False, "adaptation": "off"})
            _walk(trainer, 40, 85)  # density control changes the number of Gaussians on the way
            assert len(trainer.gaussians) != len(start.filter_3d)
        trainer.restore(start)
        trainer.train(40, 45, 240, 0.0)
        ends.append({name: value.detach().clone() for name, value in trainer.gaussians.parameters.items()})
    assert all(torch.equal(ends[0][name], ends[1][name]) for name in ends[0])


def test_density_control_that_a_trial_put_off_comes_right_after_it():
    trainer = Trainer(training_set(), options(**OPEN, densify_every=20), 0)
    trainer._scaled = trainer._scale_views()
    trainer.train(0, 25, 240, 0.15)  # a trial over step 20
    before = len(trainer.gaussians)
    trainer._next(25, 0.15)
    after = len(trainer.gaussians)
    trainer._next(26, 0.15)
    assert after != before and len(trainer.gaussians) == after


@pytest.mark.slow
def test_tiles_are_held_back_until_the_trials_are_over():
    trainer = Trainer(training_set(), options(**OPEN), 0)
    assert trainer._scale_views()[1][0].held_back is not None
    trainer.fit(Budget(), Recorder())
    assert trainer._scaled[1][0].held_back is None


def test_the_length_of_a_trial_is_a_share_of_the_training_and_shows_every_photograph_twice():
    trials = Trials(None, GaussianOptions.of(lens_trials="lens", lens_trials_steps=0.03))
    assert trials.length(5000, 17) == 150
    assert trials.length(2000, 50) == 100
    assert trials.length(600, 50) == 36  # but no more than 6 % of it
    assert trials.length(30_000, 17) == 200  # and no longer than is needed
    assert trials.length(30_000, 250) == 500


def test_what_other_options_settle_is_not_asked():
    asked = {"lens_trials": "lens,share,model"}
    assert questions(GaussianOptions.of(**asked)) == ("lens", "share", "model")
    assert questions(GaussianOptions.of(**asked, lens_per="scene")) == ("lens", "model")
    assert questions(GaussianOptions.of(**asked, lens_model="samples")) == ("lens", "share")
    assert questions(GaussianOptions.of(**asked, lens=False)) == ("share", "model")


@pytest.mark.parametrize(("gains", "better"), [((0.1, 1.0), True), ((-0.2, 1.0), False), ((0.04, 0.04), False)])
def test_a_forward_model_is_taken_that_is_better_by_a_standard_error(gains, better):
    """Means of 0.55, 0.4 and 0.04 dB with standard errors of 0.45, 0.6 and 0; as good as equal up to 0.05 dB."""

    class Told(Scripted):
        def held_out_scores(self, share):
            points = self.changes.get("lens_model") == "samples"
            values = gains if points else (0.0, 0.0)
            return HeldOutScores(0.0, 0.0, {name: (gain, 0.0) for name, gain in zip("ab", values, strict=True)})

    trainer = Told({})
    _, [decision] = Trials(trainer, GaussianOptions.of(lens_trials="model")).decide(400, 1000, 0.4)
    assert decision.runs is better and (trainer.changes != {}) is better
    assert set(decision.figures) == {"points gain", "points error"}


@pytest.mark.parametrize(
    ("limit", "decided"),
    [
        (0.5, {"lens": None, "lens_per_view": None, "lens_samples": None}),
        (1.5, {"lens": True, "lens_per_view": None, "lens_samples": None}),
        (2.5, {"lens": True, "lens_per_view": True, "lens_samples": None}),
        (3.5, {"lens": True, "lens_per_view": True, "lens_samples": True}),
    ],
)
def test_trials_without_time_leave_their_question_undecided(limit, decided):
    """A trial takes a second, and the first of four goes on with the training. What isn't tried stays as it was, also
    where a trial would have changed it."""
    trainer = Scripted({**GOOD, "samples": 3.0})
    asked = GaussianOptions.of(lens_trials="lens,share,model")
    step, decisions = Trials(trainer, asked).decide(400, 1000, 0.4, left=lambda: limit - trainer.passed)
    assert step == 440 and len(trainer.log) == 1 + int(limit)
    tried = {one.stage: (one.runs if "dB" in one.reason else None) for one in decisions}
    assert tried == decided
    untried = [one for one in decisions if decided[one.stage] is None]
    assert all("too little time" in one.reason and not one.figures for one in untried if one.stage != "lens_per_view")
    assert {one.stage: one.runs for one in untried} == {
        stage: stage != "lens_samples" for stage, known in decided.items() if known is None
    }
    assert (trainer.changes != {}) is (decided["lens_samples"] is True)


def test_trials_wait_until_every_photograph_was_seen():
    trials = Trials(Scripted({}), GaussianOptions.of(lens_trials="lens", lens_trials_at=0.3))
    assert not trials.due(19, 0.9) and trials.due(20, 0.3) and not trials.due(20, 0.29)


class Ticking(Recorder):
    """Training time by the call: each look at the clock takes so long."""

    def __init__(self, tick):
        super().__init__()
        self._now, self._tick = 0.0, tick

    def seconds(self):
        self._now += self._tick
        return self._now


def test_trials_keep_a_training_time():
    """240 steps are planned; 2 s at 10 ms a look, one look a step and two for each that times a stage, allow fewer than
    200. The trials are due at 0.4 of the steps; their length is a share of all, and they may take 0.35 of the time."""
    trainer = Trainer(training_set(), options(**OPEN), 0)
    lengths = []
    decide = trainer._trials.decide

    def seen(step, total, progress, tell, left):
        lengths.append((step, total, left(), clock.seconds()))
        return decide(step, total, progress, tell, left)

    trainer._trials.decide = seen
    clock = Ticking(0.01)
    outcome = trainer.fit(Budget(seconds=2.0), clock)
    [(step, total, allowed, spent)] = lengths
    assert outcome.status is Status.OK and clock.seconds() <= 2.1
    assert step + (2.0 - spent) / 0.01 <= total < 200 and 0.68 <= allowed < 0.7
    assert 0.4 * total - ONE_STEP <= step <= 0.4 * total + ONE_STEP
    assert outcome.decisions[0].figures


def test_a_trial_that_is_too_slow_is_given_up_after_few_steps():
    trainer = Trainer(training_set(), options(**OPEN), 0)
    trainer._scaled = trainer._scale_views()
    taken, now = [], [0.0]

    def left():
        now[0] += 0.1
        return 2.0 - now[0]

    assert trainer.train(0, 60, 240, 0.4, lambda done, of: taken.append(done), left) is False
    assert taken == [0, 1, 2]
    assert trainer.train(0, 60, 240, 0.4, lambda done, of: taken.append(done), lambda: 0.0) is False
    assert taken == [0, 1, 2]
    assert trainer.train(0, 5, 240, 0.4, lambda done, of: taken.append(done), lambda: 2.0)
    assert taken == [0, 1, 2, *range(5)]
