"""Early stopping: the model with the best score on held-out pixels is kept, and training ends without a gain."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from made_up import Recorder
from small_scene import noise, options, training_set

from dofbench.core.budget import Budget
from dofbench.core.contracts import FitOutcome, TrainingSet
from dofbench.core.errors import InputError
from dofbench.training.gaussians import early_stopping
from dofbench.training.gaussians.early_stopping import EarlyStopping, StoppingOptions
from dofbench.training.gaussians.trainer import Trainer

_OPTIONS = {"steps": 200, "held_back": 0.2, "lens": False, "adaptation": "off", "normal_weight": 0.0}
_OPTIONS |= {"depth_weight": 0.0, "patience": 0.2}

Scored = list[tuple[int, float]]


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_stopping, "_VISITS", 1)


def trained(scene: TrainingSet, observer: Recorder, **changes: Any) -> tuple[Trainer, FitOutcome, Scored]:
    """A training, how it ended, and the scores in its course by step."""
    trainer, scores = Trainer(scene, options(**{**_OPTIONS, **changes}), 0), []
    noted = trainer._stopping.scored

    def scored(step: int, progress: float, ssim: float, snapshot: Callable[[], Any]) -> bool:
        scores.append((step, ssim))
        return noted(step, progress, ssim, snapshot)

    trainer._stopping.scored = scored  # type: ignore[method-assign]
    return trainer, trainer.fit(Budget(), observer), scores


@pytest.mark.usefixtures("often")
def test_a_scene_that_overfits_stops_and_keeps_the_model_with_the_best_score() -> None:
    """Two views of one noise from two places can only be learned by heart."""
    trainer, outcome, scores = trained(noise(), Recorder())
    best = max(scores, key=lambda one: one[1])
    assert scores[-1][1] < best[1] and outcome.steps == scores[-1][0] < 200
    decision = outcome.decisions[-1]
    assert decision.stage == "early_stopping" and decision.figures["kept"] == best[0]
    before, *_ = trained(noise(), Recorder(stop_after=best[0]))
    for name, value in before.gaussians.parameters.items():
        assert torch.equal(value, trainer.gaussians.parameters[name]), name


@pytest.mark.usefixtures("often")
def test_the_cooldown_follows_from_the_best_state_and_is_as_long_as_of_a_short_training() -> None:
    trainer, outcome, scores = trained(noise(), observer := Recorder(), cooldown_from=0.8)
    best = max(scores, key=lambda one: one[1])
    assert outcome.steps == scores[-1][0] + round(best[0] / 4) == len(observer.losses)
    assert trainer.held_out_scores().ssim >= best[1]


@pytest.mark.usefixtures("often")
def test_a_training_that_gains_to_the_end_is_the_same_with_and_without_the_scores() -> None:
    with_scores, outcome, scores = trained(training_set(), Recorder())
    assert len(scores) > 5 and outcome.steps == 200 == outcome.decisions[-1].figures["kept"]
    without, outcome, scores = trained(training_set(), Recorder(), patience=0.0)
    assert not scores and not outcome.decisions
    for name, value in without.gaussians.parameters.items():
        assert torch.equal(value, with_scores.gaussians.parameters[name]), name


def test_training_is_scored_so_rarely_that_it_takes_little_time() -> None:
    stopping = EarlyStopping(StoppingOptions(patience=0.2), 1.0, views=10)
    scored = []
    for step in range(3000):
        if stopping.due(step, step / 3000):
            scored.append(step)
            stopping.scored(step, step / 3000, float(step), lambda: None)
    assert 0 < 10 * len(scored) <= 3000 / 20  # renderings of a view


def test_a_score_that_isn_t_finite_is_never_the_best() -> None:
    stopping = EarlyStopping(StoppingOptions(patience=0.2), 1.0, views=1)
    assert not stopping.scored(10, 0.1, math.nan, lambda: "nan") and stopping.best is None
    assert stopping.scored(20, 0.2, 30.0, lambda: "good")
    assert not stopping.scored(30, 0.5, math.nan, lambda: "nan")
    assert stopping.stopped == 30 and stopping.best is not None and stopping.best.state == "good"


def test_nothing_is_stopped_in_the_cooldown() -> None:
    stopping = EarlyStopping(StoppingOptions(patience=0.2), 0.8, views=1)
    assert stopping.due(790, 0.79) and not stopping.due(800, 0.8)


@pytest.mark.usefixtures("often")
def test_scores_that_a_reset_of_opacities_sets_back_stop_nothing() -> None:
    resets = {"reset_every": 0.1, "densify_until": 0.5}
    _, outcome, scores = trained(training_set(), Recorder(), **resets)
    assert scores[0][0] >= 100 and outcome.steps == 200
    _, _, scores = trained(training_set(), Recorder(), densify_until=0.5)
    assert scores[0][0] < 100


def test_patience_needs_held_out_pixels() -> None:
    with pytest.raises(InputError):
        options(patience=0.2)
