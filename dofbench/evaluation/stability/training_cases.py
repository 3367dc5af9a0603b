"""Training on difficult scenes and with extreme options: does it converge, and is a failure detected?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache, partial

import numpy as np
import torch

from dofbench.core.budget import Budget
from dofbench.core.contracts import FitOutcome, NonFinite, TrainingSet
from dofbench.core.errors import Status
from dofbench.evaluation.stability.case import COMPILED, Case, Found, Setting, Subject
from dofbench.evaluation.stability.short_trainings import DENSIFY_EVERY, STEPS, End, Watch, faster, options_of, run
from dofbench.evaluation.stability.training_scene import (
    VIEWS,
    around,
    black,
    noise,
    nothing_but_noise,
    scene,
    spoiled,
    wrong_pose,
)
from dofbench.methods.cards import MethodEntry, find_method, method_files
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.trainer import Trainer

RATES = ("means_lr", "means_lr_final", "sh_dc_lr", "sh_rest_lr", "opacity_lr", "scale_lr", "rotation_lr")
LENS_RATES = ("lens_lr", "lens_lr_final")
GAUSSIANS = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
SEEDS = (0, 1)
START_APERTURES, START_FOCI = (0.5, 2.0, 6.0), (-0.5, 0.25, 0.75, 1.5)


def _summary(ends: list[End], with_lens: bool) -> str:
    statuses = ", ".join(f"{count} {status}" for status, count in sorted(Counter(end.status for end in ends).items()))
    parts = [f"{statuses} of {len(ends)}", f"loss fell in {sum(end.better for end in ends)}"]
    if with_lens:
        parts.append(f"lens found in {sum(end.found for end in ends)}")
    wrong = [end.wrong for end in ends if end.wrong]
    return "; ".join(parts + ([f"{len(wrong)} wrong: {wrong[0]}"] if wrong else []))


def _measured(entry: MethodEntry, ends: list[End]) -> Found:
    return Found(float(sum(bool(end.wrong) for end in ends)), 0.0, _summary(ends, entry.card.capabilities.learns_lens))


def _hard(setting: Setting, method: str, make: Callable[[], TrainingSet], one_plane: bool = False) -> Found:
    entry = find_method(method)
    return _measured(entry, [run(entry, make(), seed, one_plane=one_plane) for seed in SEEDS])


def _fast(setting: Setting, method: str, names: tuple[str, ...], factor: float) -> Found:
    entry = find_method(method)
    return _measured(entry, [run(entry, scene(), seed, **faster(entry, names, factor)) for seed in SEEDS])


def _ours(entry: MethodEntry) -> bool:
    """Whether the method uses this project's trainer of Gaussians."""
    return isinstance(entry.create({}, 0, "cpu"), GaussianMethod)


def _own_scene(entry: MethodEntry) -> TrainingSet:
    """The scene, blurred as the method itself would blur it."""
    return scene(own_blur=entry.id == "dofgs")


@cache
def _from_grid(method: str) -> dict[tuple[float, float], End]:
    entry = find_method(method)
    return {
        (aperture, focus): run(entry, _own_scene(entry), lens_init_aperture=aperture, lens_init_focus=focus)
        for aperture in START_APERTURES
        for focus in START_FOCI
    }


def _starts(setting: Setting, method: str) -> Found:
    return _measured(find_method(method), list(_from_grid(method).values()))


def _starts_found(setting: Setting, method: str) -> Found:
    grid = _from_grid(method)
    lost = [f"A {aperture:g} F {focus:g}" for (aperture, focus), end in grid.items() if not end.found]
    note = f"{len(grid) - len(lost)} of {len(grid)} starts end at the lens"
    return Found(len(lost) / len(grid), 0.0, note + (f"; not {', '.join(lost)}" if lost else ""))


def _usual(setting: Setting, method: str) -> Found:
    entry = find_method(method)
    ends = [run(entry, _own_scene(entry), seed) for seed in SEEDS]
    learns = entry.card.capabilities.learns_lens and _ours(entry)
    good = sum(end.better and (end.found or not learns) for end in ends)
    return Found(1 - good / len(ends), 0.0, _summary(ends, learns))


def _spoilt(
    method: str, steps: int, spoil: Callable[[Trainer], None], right: Callable[[NonFinite, int], bool]
) -> Found:
    """Spoil a training after step 7; error 0 if it ends as diverged. right: checks the reported event and the number of
    steps."""
    entry = find_method(method)
    made = entry.create(options_of(entry), 0, "cpu")
    assert isinstance(made, GaussianMethod)
    trainer = Trainer(scene(), made.options, 0)
    try:
        outcome = trainer.fit(Budget(steps=steps), Watch(lambda step: spoil(trainer) if step == 7 else None))
    except Exception as error:
        return Found(1.0, 0.0, f"no status: {type(error).__name__}: {error}"[:120])
    return _diverged(outcome, right)


def _diverged(outcome: FitOutcome, right: Callable[[NonFinite, int], bool]) -> Found:
    event = outcome.nonfinite[0] if outcome.nonfinite else None
    said = outcome.status is Status.DIVERGED and event is not None and right(event, outcome.steps)
    return Found(0.0 if said else 1.0, 0.0, f"{outcome.status}: {outcome.message}"[:120])


def _planted(setting: Setting, method: str, what: str, value: float) -> Found:
    """Put a non-finite number into the training after step 7: step 8 must report it and its place."""

    def plant(trainer: Trainer) -> None:
        if what == "lens":
            assert trainer.lenses is not None
            trainer.lenses.spoil(value)
        else:
            with torch.no_grad():
                trainer.gaussians.parameters[what].view(len(trainer.gaussians), -1)[11, 0] = value

    views = {view.name for view in scene().views}
    return _spoilt(method, 20, plant, lambda event, steps: (steps, event.step) == (8, 8) and event.view in views)


def _vanished(setting: Setting, method: str, what: str) -> Found:
    """Make all Gaussians fade, or move all behind the cameras: the step that finds none must report it."""

    def vanish(trainer: Trainer) -> None:
        with torch.no_grad():
            if what == "faded":
                trainer.gaussians.parameters["opacity_logits"][:] = -20.0
            else:
                trainer.gaussians.parameters["means"][:, 2] = -5.0

    # Density control checks every few steps; BAGS also checks all Gaussians at each finer scale.
    return _spoilt(method, STEPS, vanish, lambda event, steps: event.step == steps <= DENSIFY_EVERY)


def _bad_photograph(setting: Setting, method: str, value: float) -> Found:
    """Put a non-finite number into a training view: the first step that uses the view must report it."""

    def spoil(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[20, 30, 1] = value
        return image

    entry = find_method(method)
    outcome = entry.create(options_of(entry), 0, "cpu").fit(spoiled(scene(), 3, spoil), Budget(steps=STEPS), Watch())
    return _diverged(outcome, lambda event, steps: event.view == "v3" and event.step == steps <= VIEWS)


def cases_of(method: str) -> tuple[Case, ...]:
    """The cases of one method. Cases that set options exist only for methods with this project's trainers."""
    entry = find_method(method)
    learns, ours = entry.card.capabilities.learns_lens, _ours(entry)
    training = Subject("training", method, COMPILED, prefix=f"{method}-")
    each = partial(training.each, method=(method,))
    made = {
        "3-views": partial(scene, 3),
        "around": around,
        "textureless": partial(scene, textureless=True),
        "noise": partial(noise, 0.2),
        "only-noise": nothing_but_noise,
        "wrong-pose": wrong_pose,
        "one-black": partial(black, 3),
        "all-black": partial(black, None),
    }
    found: list[Case] = []
    if ours or isinstance(entry.create({}, 0, "cpu"), FieldMethod):
        found += each("usual", _usual)
    found += each("{make_label}", _hard, make=made)
    found += each("photograph-{value}", _bad_photograph, value=(np.nan, np.inf))
    if ours:
        found += each("rates-x{factor:g}", _fast, names=(RATES,), factor=(10.0, 100.0, 1e4))
        found += each("planted-nan-{what}", _planted, what=GAUSSIANS, value=(np.nan,))
        found += each("planted-inf-means", _planted, what=("means",), value=(np.inf,))
        found += each("vanished-{what}", _vanished, what=("faded", "behind"))
    if ours and learns:
        found += each("one-plane", _hard, make=(partial(scene, one_plane=True),), one_plane=(True,))
        found += each("lens-rates-x{factor:g}", _fast, names=(LENS_RATES,), factor=(10.0, 100.0))
        found += each("all-rates-x{factor:g}", _fast, names=(RATES + LENS_RATES,), factor=(10.0, 100.0))
        found += each("bad-starts", _starts)
        found += each("bad-starts-found", _starts_found)
        found += each("planted-{value}-lens", _planted, what=("lens",), value=(np.nan, np.inf))
    return tuple(found)


def cases(method: str | None = None) -> tuple[Case, ...]:
    """The cases of one method, or of all methods found. Raises InputError for an unknown one."""
    chosen = [method] if method is not None else list(method_files())
    return tuple(case for one in chosen for case in cases_of(one))
