"""What a run will do and what it leaves out, with the reason: plain data, decided before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dofbench.core.contracts import Budget, Decision
from dofbench.core.errors import InputError
from dofbench.dataset.benchmark_dataset import BenchmarkDataset
from dofbench.results.protocol import BY_BLUR, EXIF_COLUMNS, LENS_COLUMNS, OF_LENSES, Protocol
from dofbench.results.run_spec import format_budget
from dofbench.running.facts import Facts
from dofbench.running.method_cards import MethodEntry
from dofbench.scoring.exif_scores import asked_by_exif, missing_exif
from dofbench.scoring.ground_truth import NO_TEST_VIEWS, MissingTruth, missing_truth

NEEDLESS_BLUR = 0.75  # px, radius as estimated: photographs in focus give up to 0.6
CLEAR_BLUR = 2.0  # px: from here on the estimate alone tells that there is a lens
NEEDLESS_DEPENDENCE = 2.5  # levels of 255: below it no harmonics would be seen
NEEDLESS_COLOURS = 12.0  # per cent: up to 10 a learned colour was worth nothing, at 21 a decibel
NEEDLESS_LIGHT = 0.3  # stops by EXIF, where no points can tell
TRIED = "whether that helps is tried while training"


@dataclass(frozen=True)
class Stage:
    """A part of the method that the data may or may not need. runs: what was decided."""

    name: str
    runs: bool
    reason: str

    def line(self) -> str:
        """What was decided and why, for the user."""
        return f"stage {self.name}: {'runs' if self.runs else 'left out'}: {self.reason}"


@dataclass(frozen=True)
class RunPlan:
    """Printed by --dry-run and stored in the result.

    budget: as `--budget` takes it. options: what the method is created with. facts: what the training photographs
    show, as `Facts`. lenses: as `dealt_lenses`. columns: scores that will be measured.
    left_out: scores that will not, with the reason.
    """

    method: str
    preset: str
    dataset: str
    protocol: str
    budget: str
    seed: int
    device: str
    options: dict[str, Any]
    train_views: int
    test_views: int
    facts: Facts
    lenses: dict[str, Any]
    stages: tuple[Stage, ...]
    columns: tuple[str, ...]
    left_out: dict[str, str]

    def as_data(self) -> dict[str, Any]:
        """Plain data, for the result."""
        return asdict(self)

    def lines(self) -> list[str]:
        """The plan as text, one line a fact."""
        lines = [
            f"{self.method} ({self.preset}, seed {self.seed}, {self.device}) on {self.dataset}, {self.protocol}",
            f"budget {self.budget}; {self.train_views} training views, {self.test_views} test views, "
            f"{self.facts.points} sparse points",
            "options " + (", ".join(f"{key}={value}" for key, value in self.options.items()) or "the method's own"),
        ]
        lines += [stage.line() for stage in self.stages]
        lines.append("scores " + (", ".join(self.columns) or "none"))
        reasons: dict[str, list[str]] = {}
        for column, reason in self.left_out.items():
            reasons.setdefault(reason, []).append(column)
        lines += [f"no {', '.join(columns)}: {reason}" for reason, columns in reasons.items()]
        return lines


def dealt_lenses(dataset: BenchmarkDataset) -> dict[str, Any]:
    """How the dataset deals its lenses ("assign"), and per split ("train", "test") view -> [A, F], or None where nobody
    knows the lens; as plain data."""
    dealt = {
        split: {
            view.name: None if view.lens is None else [view.lens.aperture, view.lens.focus]
            for view in dataset.views
            if view.split == split
        }
        for split in ("train", "test")
    }
    return {"assign": dataset.assign, **dealt}


def make_plan(
    entry: MethodEntry,
    preset: str,
    options: dict[str, Any],
    overrides: dict[str, Any],
    budget: Budget,
    dataset: BenchmarkDataset,
    facts: Facts,
    protocol: Protocol,
    *,
    seed: int,
    device: str,
    force_all: bool,
) -> RunPlan:
    """Decide from the dataset, from what its photographs show and from the method's card.

    options: the preset's; overrides: the user's, which win over what the plan sets. force_all: every
    stage runs, needed or not. Raises InputError when the dataset lacks what the method can't do without.
    """
    train = dataset.training_views()
    test = dataset.test_views()
    if not train:
        raise InputError(f"dataset {dataset.name}", "no training view", "at least one")
    if entry.card.capabilities.needs_points and not facts.points:
        raise InputError(f"dataset {dataset.name}", "no sparse points", f"some, as {entry.id} starts from them")

    stages, switched = _stages(
        entry, {**options, **overrides}, overrides, facts, force_all, protocol.inputs == "all-in-focus"
    )
    left_out = _left_out(entry, protocol, stages, missing_truth(dataset))
    exif = EXIF_COLUMNS if asked_by_exif(dataset, protocol.inputs) else ()
    if reason := _no_exif(entry, stages, dataset):
        left_out |= dict.fromkeys(exif, reason)
    every = (
        *protocol.refocus_columns,
        *protocol.all_in_focus_columns,
        *protocol.photograph,
        *protocol.lens,
        *exif,
        *protocol.depth,
    )
    return RunPlan(
        method=entry.id,
        preset=preset,
        dataset=dataset.name,
        protocol=protocol.id,
        budget=format_budget(budget),
        seed=seed,
        device=device,
        options={**options, **switched, **overrides},
        train_views=len(train),
        test_views=len(test),
        facts=facts,
        lenses=dealt_lenses(dataset),
        stages=tuple(stages),
        columns=tuple(column for column in every if column not in left_out),
        left_out=left_out,
    )


class _Trials:
    """What the method would try out while training, and which of it the plan knows already, or the user has decided.
    force_all: try nothing."""

    _DECIDED_BY = {"lens": "lens", "share": "lens_per", "model": "lens_model"}

    def __init__(self, options: dict[str, Any], overrides: dict[str, Any], force_all: bool):
        self._before = str(options.get("lens_trials", ""))
        words = [] if force_all else [word for word in self._before.split(",") if word]
        self._open = [word for word in words if self._DECIDED_BY.get(word) not in overrides]

    def about(self, question: str, *, known: bool) -> bool:
        """Whether it will be tried; a question whose answer is known is closed."""
        if known and question in self._open:
            self._open.remove(question)
        return question in self._open

    def close(self) -> None:
        """Try nothing: without a lens there is nothing to be tried."""
        self._open = []

    def switched(self) -> dict[str, str]:
        """The option as it must be, where that differs from what it was."""
        now = ",".join(self._open)
        return {} if now == self._before else {"lens_trials": now}


def revised(plan: dict[str, Any], decisions: Sequence[Decision]) -> dict[str, Any]:
    """The plan, as plain data, with what training decided for itself in place of what was open, and its reasons."""
    found = {decision.stage: decision for decision in decisions}
    stages = [
        {**stage, "runs": found[stage["name"]].runs, "reason": found[stage["name"]].reason}
        if stage["name"] in found
        else stage
        for stage in plan["stages"]
    ]
    return {**plan, "stages": stages}


def decided(before: Sequence[Stage], plan: dict[str, Any]) -> list[str]:
    """A line for each stage of which training decided otherwise, or for another reason, than was planned before it.

    plan: as plain data, from the result.
    """
    was = {stage.name: stage for stage in before}
    now = [Stage(**stage) for stage in plan["stages"]]
    return [stage.line() for stage in now if stage != was.get(stage.name)]


def _stages(
    entry: MethodEntry, options: dict[str, Any], overrides: dict[str, Any], facts: Facts, force_all: bool, sharp: bool
) -> tuple[list[Stage], dict]:
    """What runs and what doesn't, and the options that switch off what doesn't. sharp: the call says that the
    photographs are all in focus."""
    stages, switched = [], {}

    def decide(name: str, needless: bool, why: str) -> bool:
        """needless: whether the stage could be left out; why: the fact that says so, either way."""
        switch = entry.card.leave_out.get(name)
        if switch is not None and all(options.get(key) == value for key, value in switch.items()):
            return False  # the preset or the user has switched it off: nothing to be decided
        if switch is not None and next(iter(switch)) in overrides:
            return True  # the user has decided; what else the switch sets only goes with it
        runs = not needless or force_all or switch is None
        if needless and force_all:
            why = f"--force-all, although {why}"
        elif needless and switch is None:
            why = f"{entry.id} can't leave it out, although {why}"
        elif not runs:
            switched.update(switch)
        stages.append(Stage(name, runs, why))
        return runs

    if entry.card.capabilities.learns_lens:
        asked = _Trials(options, overrides, force_all)
        blur = facts.blur_px
        shown = (
            "the photographs don't tell how blurred they are"
            if blur is None
            else f"the photographs show circles of confusion of up to {blur:.2f} px, by an estimate of which "
            f"{NEEDLESS_BLUR} px mean nothing"
        )
        needless = blur is not None and blur < NEEDLESS_BLUR
        if sharp and needless:
            shown += ", and the call says that they are all in focus"
        elif asked.about("lens", known=blur is not None and blur >= CLEAR_BLUR):
            # Points are found where a photograph is sharp, so what they show can't tell that there is no lens.
            needless, shown = False, f"{shown}; {TRIED}"
        if decide("lens", needless, shown):
            said = (
                "the dataset says: one lens took all photographs"
                if facts.one_lens
                else "the dataset says: photographs by several lenses"
                if facts.one_lens is not None
                else "nobody knows the photographs' lenses, so each may have one of its own"
            )
            tied = (
                facts.one_lens is None
                and "aperture_per_view" in entry.card.leave_out
                and decide(
                    "aperture_per_view",
                    facts.f_numbers,
                    "EXIF has the f-number of every photograph, by one camera at one "
                    "focal length: they share one aperture x f-number, and have a focus each"
                    if facts.f_numbers
                    else "EXIF doesn't say how the photographs' apertures compare",
                )
                is False
            )
            if asked.about("share", known=tied or facts.one_lens is not None):
                said = f"{said}; {TRIED}"
            if not tied:
                decide("lens_per_view", bool(facts.one_lens), said)
            if asked.about("model", known=False):
                stages.append(Stage("lens_samples", True, f"nobody knows how the photographs were blurred; {TRIED}"))
        else:
            asked.close()
        switched.update(asked.switched())
    supervised = True
    if entry.card.capabilities.needs_points or "sparse_depth" in entry.card.leave_out:
        supervised = decide("sparse_depth", not facts.points, f"{facts.points or 'no'} sparse points")
    if "normals" in entry.card.leave_out:
        decide(
            "normals",
            not supervised,
            "they smooth what depth supervision has placed"
            if supervised
            else "without depth supervision they smooth what nothing has placed",
        )
    if "harmonics" in entry.card.leave_out:
        spread = facts.view_dependence
        even = spread is not None and spread < NEEDLESS_DEPENDENCE
        decide(
            "harmonics",
            even,
            "too few points are seen often enough to tell"
            if spread is None
            else f"surfaces change by {spread:.1f} of 255 with the direction, {NEEDLESS_DEPENDENCE} can be seen",
        )
    if "colours" in entry.card.leave_out:
        decide("colours", *_even_colours(facts))
    return stages, switched


def _no_exif(entry: MethodEntry, stages: list[Stage], dataset: BenchmarkDataset) -> str:
    """Why learned apertures can't be compared with EXIF, or ""."""
    if not entry.card.capabilities.learns_lens:
        return f"{entry.card.name} learns no lens"
    left = next((stage for stage in stages if stage.name == "lens" and not stage.runs), None)
    return f"the lens was left out: {left.reason}" if left is not None else missing_exif(dataset)


def _even_colours(facts: Facts) -> tuple[bool, str]:
    """Whether the photographs are alike in exposure and white balance, and what says so."""
    spread, light = facts.colour_spread, facts.light_spread
    if spread is not None:
        return spread < NEEDLESS_COLOURS, (
            f"exposure and white balance differ by {spread:.1f} % over the photographs, "
            f"of which less than {NEEDLESS_COLOURS:.0f} % need no colours of their own"
        )
    if light is not None:
        return light < NEEDLESS_LIGHT, (
            f"too few points are shared to tell, and by EXIF the light let in differs by "
            f"{light:.1f} stops, of which {NEEDLESS_LIGHT} mean nothing"
        )
    return True, "too few points are shared to tell whether exposure or white balance differ, and EXIF says nothing"


def _left_out(entry: MethodEntry, protocol: Protocol, stages: list[Stage], missing: MissingTruth) -> dict[str, str]:
    capabilities = entry.card.capabilities
    refocus = missing.refocus
    if not capabilities.refocus and refocus != NO_TEST_VIEWS:
        refocus = f"{entry.card.name} has no lens to refocus with"
    lens_stage = next((stage for stage in stages if stage.name == "lens"), None)
    if not capabilities.learns_lens:
        lens = f"{entry.card.name} learns no lens"
    elif not protocol.lens:
        lens = f"{protocol.id} trains on sharp photographs, which have no lens to be learned"
    elif missing.lens:
        lens = missing.lens
    else:
        lens = f"the lens was left out: {lens_stage.reason}" if lens_stage is not None and not lens_stage.runs else ""
    blur = ""
    if not capabilities.refocus:
        blur = f"{BY_BLUR}: {entry.card.name} has no lens"
    elif lens_stage is not None and not lens_stage.runs:
        blur = f"{BY_BLUR}: the lens was left out: {lens_stage.reason}"
    reasons = (
        (tuple(column for column in protocol.photograph if column in OF_LENSES), blur),
        (protocol.refocus_columns, refocus),
        (protocol.all_in_focus_columns, missing.all_in_focus),
        (LENS_COLUMNS, lens),
        (protocol.depth, missing.depth),
    )
    return {column: reason for columns, reason in reasons if reason for column in columns}
