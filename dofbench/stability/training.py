"""Training on scenes and with options that are too hard for it: what converges, what is found out, what goes wrong.

A tiny scene, rendered and blurred by the method's own model, so that nothing but the start, the rates and what was done
to the photographs stands in the way.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch

from dofbench.cameras import Camera
from dofbench.contracts import Budget, FitOutcome, Method, PointCloud, TrainingSet, TrainingView
from dofbench.defocus import defocus
from dofbench.errors import Status
from dofbench.gaussians.method import GaussianMethod
from dofbench.gaussians.options import TrainerOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.harness.methods import MethodEntry, find_method, method_files
from dofbench.kernels import load
from dofbench.lens import DisparityRange, Lens
from dofbench.stability.case import COMPILED, Case, Found, Setting

WIDTH, HEIGHT, STEPS, VIEWS = 64, 48, 240, 6
NEAR, FAR = 2.0, 6.0
# Wider than 0 ... 1: on so few pixels those would blur by one. A = 5 is 6.4 pixels.
TRUE_APERTURES, TRUE_FOCI = (3.0, 5.0), (0.2, 0.5, 0.8)
FOUND = 0.5  # of the error in circles of confusion that A = F = 0.5 has, the harness's predictor that learns nothing
ABSURD_LIGHT, ABSURD_DEPTH = 10.0, 1e3 * FAR
# What the schedule of thousands of steps becomes in a hundred, and no depth prior that takes longer than that.
SHORT = {
    "steps": STEPS,
    "depth_prior": "sparse",
    "start_points": 0,
    "sh_degree": 1,
    "densify_every": 25,
    "max_gaussians": 800,
    "coarse_until": 0.0,
    "reset_every": 0.0,
    "scale_lr": 2e-2,
}
SHORT_LENS = {"lens_lr": 0.2, "lens_lr_final": 0.025, "lens_init_aperture": 2.0}
RATES = ("means_lr", "means_lr_final", "sh_dc_lr", "sh_rest_lr", "opacity_lr", "scale_lr", "rotation_lr")
LENS_RATES = ("lens_lr", "lens_lr_final")
SANE = "no run ends as ok with a number that isn't finite or can't be, and none without a status"
SANE_BOUND = "0 runs: light within 10 times white, depth finite, a circle of confusion no wider than the image"


class Watch:
    """An observer that keeps every loss, and may do something to the training after a step."""

    def __init__(self, meddle: Callable[[int], None] | None = None):
        self.losses: list[float] = []
        self._meddle, self._start = meddle, time.perf_counter()

    def seconds(self) -> float:
        """Since the start."""
        return time.perf_counter() - self._start

    def after_step(self, step: int, loss: float) -> bool:
        """Go on, always."""
        self.losses.append(loss)
        if self._meddle is not None:
            self._meddle(step)
        return True


# ---- the scene ----


@cache
def true_range() -> DisparityRange:
    """What F = 0 and F = 1 mean."""
    return DisparityRange(1 / FAR, 1 / NEAR)


def true_lens(view: int, one_plane: bool = False) -> Lens:
    """The lens that took a view; `one_plane`: all are focused at 0.5."""
    focus = 0.5 if one_plane else TRUE_FOCI[view % len(TRUE_FOCI)]
    return Lens(TRUE_APERTURES[view % len(TRUE_APERTURES)], focus)


@cache
def scene(views: int = VIEWS, one_plane: bool = False, textureless: bool = False) -> TrainingSet:
    """Photographs of two layers of coloured dots, and their centres as sparse points."""
    random = np.random.default_rng(0)
    count = 220
    depth = np.where(random.uniform(size=count) < 0.4, NEAR + 0.4, FAR - 0.4) + random.uniform(-0.4, 0.4, count)
    xyz = np.stack(
        [random.uniform(-0.75, 0.75, count) * depth, random.uniform(-0.55, 0.55, count) * depth, depth], axis=1
    )
    xyz[:60, :2] *= 0.5
    colour = np.full((count, 3), 0.5) if textureless else random.uniform(0, 1, (count, 3))
    tensor = partial(torch.tensor, dtype=torch.float32)
    truth = {
        "means": tensor(xyz),
        "log_scales": tensor(np.log(0.035 * depth)[:, None].repeat(3, 1)),
        "quaternions": tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        "opacity_logits": torch.full((count,), 3.0),
        "sh_dc": tensor((colour - 0.5) * 2 * math.sqrt(math.pi)),
        "sh_rest": torch.zeros(count, 0, 3),
    }
    background, taken = tensor([0.5, 0.5, 0.5] if textureless else [0.15, 0.2, 0.3]), []
    for index in range(views):
        angle = 2 * math.pi * index / views
        pose = np.eye(4)
        pose[:2, 3] = -0.35 * math.cos(angle), -0.25 * math.sin(angle)
        camera = Camera(WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2, pose)
        with torch.no_grad():
            raster = load("rasterize")(**truth, camera=camera, background=background)
            surface = torch.where(raster.alpha > 0.1, raster.depth, FAR).clamp_min(NEAR / 2)
            lens = true_lens(index, one_plane).physical(true_range(), WIDTH)
            photograph = defocus(raster.color, lens.signed_radius(1 / surface, WIDTH)).clamp(0, 1)
        taken.append(TrainingView(f"v{index}", camera, photograph.numpy()))
    points = PointCloud(
        xyz + random.normal(0, 0.01, xyz.shape), colour.astype(np.float32), np.full(count, 0.3, np.float32)
    )
    return TrainingSet(tuple(taken), points)


def _spoiled(training_set: TrainingSet, index: int | None, change: Callable[[np.ndarray], np.ndarray]) -> TrainingSet:
    views = tuple(
        replace(view, image=change(view.image).astype(np.float32)) if index in (None, k) else view
        for k, view in enumerate(training_set.views)
    )
    return replace(training_set, views=views)


def _noise(sigma: float) -> TrainingSet:
    random = np.random.default_rng(1)
    return _spoiled(scene(), None, lambda image: np.clip(image + random.normal(0, sigma, image.shape), 0, 1))


def _nothing_but_noise() -> TrainingSet:
    random = np.random.default_rng(1)
    return _spoiled(scene(), None, lambda image: random.uniform(0, 1, image.shape))


def _black(index: int | None) -> TrainingSet:
    return _spoiled(scene(), index, np.zeros_like)


def _wrong_pose() -> TrainingSet:
    views = list(scene().views)
    turn, pose = 0.2, views[2].camera.world_to_camera.copy()
    rotation = np.array([[math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)]])
    pose[:3] = rotation @ pose[:3]
    views[2] = replace(views[2], camera=replace(views[2].camera, world_to_camera=pose))
    return replace(scene(), views=tuple(views))


# ---- a run and what it says ----


@dataclass(frozen=True)
class End:
    """How a run ended. wrong: what it said that can't be, if its status is ok, or that it has none."""

    status: str
    wrong: str = ""
    found: bool = False
    losses: tuple[float, ...] = field(default=(), repr=False)

    @property
    def better(self) -> bool:
        """Whether the loss fell to three quarters of where it began, an epoch's mean each."""
        epoch = min(VIEWS, max(1, len(self.losses) // 4))
        return bool(self.losses) and np.mean(self.losses[-epoch:]) < 0.75 * np.mean(self.losses[:epoch])


def options_of(entry: MethodEntry, **changes: Any) -> dict[str, Any]:
    """The method's default preset, cut short, with changes; a method of another trainer's as it is."""
    _, options, _ = entry.preset(None)
    made = entry.create({}, 0, "cpu")
    if not isinstance(made, GaussianMethod):
        return options
    short = {**SHORT, **(SHORT_LENS if entry.card.capabilities.learns_lens else {})}
    return {key: value for key, value in {**options, **short, **changes}.items() if key not in made.FORCED}


def faster(entry: MethodEntry, names: tuple[str, ...], factor: float) -> dict[str, Any]:
    """The named learning rates, times a factor."""
    usual = {**vars(TrainerOptions()), **options_of(entry)}
    return {name: usual[name] * factor for name in names}


def run(
    entry: MethodEntry, training_set: TrainingSet, seed: int = 0, *, one_plane: bool = False, **changes: Any
) -> End:
    """Train for `STEPS` steps and look at everything that the method says afterwards."""
    method = entry.create(options_of(entry, **changes), seed, "cpu")
    watch = Watch()
    try:
        outcome = method.fit(training_set, Budget(steps=STEPS), watch)
    except Exception as error:  # what `run` of the harness would have to make a status of by itself
        return End(
            "no status", f"{type(error).__name__}: {' '.join(str(error).split())}"[:100], losses=tuple(watch.losses)
        )
    if outcome.status is not Status.OK:
        return End(outcome.status, _unexplained(outcome), losses=tuple(watch.losses))
    try:
        with np.errstate(all="ignore"):
            wrong = _absurd(method, training_set, watch.losses)
    except Exception as error:
        wrong = f"after training: {type(error).__name__}: {' '.join(str(error).split())}"[:100]
    return End("ok", wrong, not wrong and _lens_found(method, one_plane), tuple(watch.losses))


def _unexplained(outcome: FitOutcome) -> str:
    if outcome.status is Status.DIVERGED and not any(event.step == outcome.steps for event in outcome.nonfinite):
        return "diverged, without saying at which step"
    return ""


def _absurd(method: Method, training_set: TrainingSet, losses: list[float]) -> str:
    if not np.isfinite(losses).all():
        return "a loss that isn't finite"
    lenses = method.lens_estimates()
    for view in training_set.views:
        lens = None if lenses is None else lenses[view.name]
        for shown in [None] if lens is None else [None, lens]:
            if lens is not None and not (math.isfinite(lens.aperture) and math.isfinite(lens.focus_disparity)):
                return f"lens of {view.name}: {lens.aperture:.3g}, {lens.focus_disparity:.3g}"
            rendering = method.render(view.camera, shown)
            if not np.isfinite(rendering.image).all() or float(np.abs(rendering.image).mean()) > ABSURD_LIGHT:
                return f"render of {view.name}: light of {float(np.abs(rendering.image).mean()):.3g} times white"
            if (
                not np.isfinite(rendering.depth).all()
                or rendering.depth.min() < 0
                or rendering.depth.max() > ABSURD_DEPTH
            ):
                return f"depth of {view.name}: {rendering.depth.min():.3g} to {rendering.depth.max():.3g}"
        if lens is not None:
            least = min(abs(float(lens.signed_radius(q, WIDTH))) for q in (true_range().q_min, true_range().q_max))
            if least > WIDTH:
                return f"lens of {view.name}: nothing blurred by less than {least:.3g} pixels"
    return ""


def _lens_found(method: Method, one_plane: bool) -> bool:
    lenses = method.lens_estimates()
    if lenses is None:
        return False
    disparities = np.linspace(true_range().q_min, true_range().q_max, 5)
    nothing = np.abs(Lens(0.5, 0.5).physical(true_range(), WIDTH).signed_radius(disparities, WIDTH))
    errors, unlearned = [], []
    for index, lens in enumerate(lenses.values()):
        true = np.abs(true_lens(index, one_plane).physical(true_range(), WIDTH).signed_radius(disparities, WIDTH))
        errors.append(np.abs(np.abs(lens.signed_radius(disparities, WIDTH)) - true).mean())
        unlearned.append(np.abs(nothing - true).mean())
    return float(np.mean(errors)) < FOUND * float(np.mean(unlearned))


def _summary(ends: list[End], with_lens: bool) -> str:
    statuses = ", ".join(f"{count} {status}" for status, count in sorted(Counter(end.status for end in ends).items()))
    parts = [f"{statuses} of {len(ends)}", f"loss fell in {sum(end.better for end in ends)}"]
    if with_lens:
        parts.append(f"lens found in {sum(end.found for end in ends)}")
    wrong = [end.wrong for end in ends if end.wrong]
    return "; ".join(parts + ([f"{len(wrong)} wrong: {wrong[0]}"] if wrong else []))


def _measured(entry: MethodEntry, ends: list[End]) -> Found:
    return Found(float(sum(bool(end.wrong) for end in ends)), 0.0, _summary(ends, entry.card.capabilities.learns_lens))


# ---- cases ----

SEEDS = (0, 1)
START_APERTURES, START_FOCI = (0.5, 2.0, 6.0), (-0.5, 0.25, 0.75, 1.5)


def _hard(setting: Setting, method: str, make: Callable[[], TrainingSet], one_plane: bool = False) -> Found:
    entry = find_method(method)
    return _measured(entry, [run(entry, make(), seed, one_plane=one_plane) for seed in SEEDS])


def _fast(setting: Setting, method: str, names: tuple[str, ...], factor: float) -> Found:
    entry = find_method(method)
    return _measured(entry, [run(entry, scene(), seed, **faster(entry, names, factor)) for seed in SEEDS])


@cache
def _from_grid(method: str) -> dict[tuple[float, float], End]:
    entry = find_method(method)
    return {
        (aperture, focus): run(entry, scene(), lens_init_aperture=aperture, lens_init_focus=focus)
        for aperture in START_APERTURES
        for focus in START_FOCI
    }


def _starts(setting: Setting, method: str) -> Found:
    return _measured(find_method(method), list(_from_grid(method).values()))


def _starts_found(setting: Setting, method: str) -> Found:
    grid = _from_grid(method)
    lost = [f"A {aperture:g} F {focus:g}" for (aperture, focus), end in grid.items() if not end.found]
    return Found(
        len(lost) / len(grid),
        0.0,
        f"{len(grid) - len(lost)} of {len(grid)} starts end at the lens" + (f"; not {', '.join(lost)}" if lost else ""),
    )


def _usual(setting: Setting, method: str) -> Found:
    entry = find_method(method)
    ends = [run(entry, scene(), seed) for seed in SEEDS]
    learns = entry.card.capabilities.learns_lens
    good = sum(end.better and (end.found or not learns) for end in ends)
    return Found(1 - good / len(ends), 0.0, _summary(ends, learns))


def _planted(setting: Setting, method: str, what: str, value: float) -> Found:
    """A number that isn't finite, put into the training after step 7: step 8 must say so, and where."""
    entry = find_method(method)
    made = entry.create(options_of(entry), 0, "cpu")
    assert isinstance(made, GaussianMethod)
    trainer = Trainer(scene(), made.options, 0)

    def plant(step: int) -> None:
        if step != 7:
            return
        if what == "lens":
            trainer.lenses._raw = [torch.full_like(raw, value) for raw in trainer.lenses._raw]
        else:
            with torch.no_grad():
                trainer.gaussians.parameters[what].view(len(trainer.gaussians), -1)[11, 0] = value

    try:
        outcome = trainer.fit(Budget(steps=20), Watch(plant))
    except Exception as error:
        return Found(1.0, 0.0, f"no status: {type(error).__name__}: {error}"[:120])
    event = outcome.nonfinite[0] if outcome.nonfinite else None
    right = (
        outcome.status is Status.DIVERGED
        and event is not None
        and (outcome.steps, event.step) == (8, 8)
        and event.view in {view.name for view in scene().views}
    )
    return Found(0.0 if right else 1.0, 0.0, f"{outcome.status}: {outcome.message}"[:120])


def _vanished(setting: Setting, method: str, what: str) -> Found:
    """Gaussians that all fade, or all get behind the cameras: the step that finds none left must say so."""
    entry = find_method(method)
    made = entry.create(options_of(entry), 0, "cpu")
    assert isinstance(made, GaussianMethod)
    trainer = Trainer(scene(), made.options, 0)

    def vanish(step: int) -> None:
        with torch.no_grad():
            if step == 7 and what == "faded":
                trainer.gaussians.parameters["opacity_logits"][:] = -20.0
            elif step == 7:
                trainer.gaussians.parameters["means"][:, 2] = -5.0

    try:
        outcome = trainer.fit(Budget(steps=STEPS), Watch(vanish))
    except Exception as error:
        return Found(1.0, 0.0, f"no status: {type(error).__name__}: {error}"[:120])
    event = outcome.nonfinite[0] if outcome.nonfinite else None
    # The first look that density control takes, every so many steps.
    right = outcome.status is Status.DIVERGED and event is not None and event.step == outcome.steps
    right = right and outcome.steps % SHORT["densify_every"] == 0
    return Found(0.0 if right else 1.0, 0.0, f"{outcome.status}: {outcome.message}"[:120])


def _bad_photograph(setting: Setting, method: str, value: float) -> Found:
    """A photograph with a number that isn't finite: the first step that looks at it must say so."""

    def spoil(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[20, 30, 1] = value
        return image

    entry = find_method(method)
    outcome = entry.create(options_of(entry), 0, "cpu").fit(_spoiled(scene(), 3, spoil), Budget(steps=STEPS), Watch())
    event = outcome.nonfinite[0] if outcome.nonfinite else None
    right = (
        outcome.status is Status.DIVERGED
        and event is not None
        and event.view == "v3"
        and event.step == outcome.steps <= VIEWS
    )
    return Found(0.0 if right else 1.0, 0.0, f"{outcome.status}: {outcome.message}"[:120])


def cases_of(method: str) -> tuple[Case, ...]:
    """The cases of one method. Those that set options are there only for methods of this project's trainer."""
    entry = find_method(method)
    learns, ours = entry.card.capabilities.learns_lens, isinstance(entry.create({}, 0, "cpu"), GaussianMethod)

    def trained(name: str, holds: str, bound: str, measure: Callable[..., Found], **arguments: Any) -> Case:
        return Case(
            "training", f"{method}-{name}", method, holds, bound, COMPILED, partial(measure, method=method, **arguments)
        )

    makers: Mapping[str, tuple[str, Callable[[], TrainingSet]]] = {
        "3-views": ("three views", partial(scene, 3)),
        "textureless": ("a scene of one colour, background and all", partial(scene, textureless=True)),
        "noise": ("noise of 0.2", partial(_noise, 0.2)),
        "only-noise": ("photographs of nothing but noise", _nothing_but_noise),
        "wrong-pose": ("one camera turned by 11 degrees", _wrong_pose),
        "one-black": ("one black photograph", partial(_black, 3)),
        "all-black": ("black photographs", partial(_black, None)),
    }
    found = [trained(name, f"{what}: {SANE}", SANE_BOUND, _hard, make=make) for name, (what, make) in makers.items()]
    found += [
        trained(
            f"photograph-{name}",
            f"{name} in a photograph: diverged at the first step that looks at it, by name",
            "0: the right step and view",
            _bad_photograph,
            value=value,
        )
        for name, value in (("nan", np.nan), ("inf", np.inf))
    ]
    if ours:
        found.insert(
            0,
            trained(
                "usual",
                "the scene as it is, the preset cut short: the loss falls, the lens is found",
                "0: the share that doesn't",
                _usual,
            ),
        )
        found += [
            trained(
                f"rates-x{factor:g}",
                f"all learning rates of the scene times {factor:g}: {SANE}",
                SANE_BOUND,
                _fast,
                names=RATES,
                factor=factor,
            )
            for factor in (10.0, 100.0, 1e4)
        ]
        planted = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
        found += [
            trained(
                f"planted-nan-{what}",
                f"NaN in {what} after step 7 is found at step 8",
                "0: the right step",
                _planted,
                what=what,
                value=np.nan,
            )
            for what in planted
        ]
        found += [
            trained(
                "planted-inf-means",
                "infinity in means after step 7 is found at step 8",
                "0: the right step",
                _planted,
                what="means",
                value=np.inf,
            )
        ]
    if ours:
        found += [
            trained(f"vanished-{what}", f"Gaussians that all {how} end as diverged, at the step that finds out",
                    "0: the right step", _vanished, what=what)
            for what, how in (("faded", "fade"), ("behind", "get behind the cameras"))
        ]
    if ours and learns:
        found += [
            trained(
                "one-plane",
                f"all photographs focused on one plane: {SANE}",
                SANE_BOUND,
                _hard,
                make=partial(scene, one_plane=True),
                one_plane=True,
            ),
            *(
                trained(
                    f"lens-rates-x{factor:g}",
                    f"the lens's learning rate times {factor:g}: {SANE}",
                    SANE_BOUND,
                    _fast,
                    names=LENS_RATES,
                    factor=factor,
                )
                for factor in (10.0, 100.0)
            ),
            *(
                trained(
                    f"all-rates-x{factor:g}",
                    f"all learning rates times {factor:g}: {SANE}",
                    SANE_BOUND,
                    _fast,
                    names=RATES + LENS_RATES,
                    factor=factor,
                )
                for factor in (10.0, 100.0)
            ),
            trained("bad-starts", f"A from 0.5 to 6, F from -0.5 to 1.5 at the start: {SANE}", SANE_BOUND, _starts),
            trained(
                "bad-starts-found",
                "and from each of them the lens is found: half the error of one that learns nothing",
                "0: the share that doesn't",
                _starts_found,
            ),
            *(
                trained(
                    f"planted-{name}-lens",
                    f"{name} in the lens after step 7 is found at step 8",
                    "0: the right step",
                    _planted,
                    what="lens",
                    value=value,
                )
                for name, value in (("nan", np.nan), ("inf", np.inf))
            ),
        ]
    return tuple(found)


def cases(method: str | None = None) -> tuple[Case, ...]:
    """The cases of one method, or of all that are found. Raises InputError for an unknown one."""
    chosen = [method] if method is not None else list(method_files())
    return tuple(case for one in chosen for case in cases_of(one))
