"""The stages and scores of a run, decided from its dataset before training, each with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from dofbench.core.contracts import Decision
from dofbench.core.errors import InputError
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset
from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.evaluation.results.protocol import (
    EXIF_COLUMNS,
    EXIF_FOCUS_COLUMNS,
    FIT_CEILING,
    LENS_COLUMNS,
    OF_LENSES,
    WITHOUT_LENS,
    Protocol,
)
from dofbench.evaluation.scoring.exif_scores import asked_by_exif, missing_exif, missing_exif_focus
from dofbench.evaluation.scoring.ground_truth import NO_TEST_VIEWS, MissingTruth, missing_truth
from dofbench.evaluation.scoring.resolved import RESOLVED_COLUMN
from dofbench.methods.cards import Card, MethodEntry
from dofbench.methods.stages.facts import Facts
from dofbench.methods.stages.stage_deciders import DECIDERS, Asked

TRIED = "tested during training"


@dataclass(frozen=True)
class Stage:
    """A part of the method that the data may or may not need. runs: what was decided."""

    name: str
    runs: bool
    reason: str

    def line(self) -> str:
        """What was decided and why: `lens: on (held-out PSNR +6.9 ± 0.6 dB with the lens)`."""
        return f"{self.name.replace('_', ' ')}: {'on' if self.runs else 'off'} ({self.reason})"


@dataclass(frozen=True)
class DataPlan:
    """The part of a plan that depends on the dataset.

    options: of the method. facts: measured on the training views. lenses: as `assigned_lenses`. points: where the
    dataset's points and poses come from; None if unknown. columns: scores to measure. left_out: skipped scores, with
    the reason. masked: share of excluded pixels by split; empty for a dataset without masks.
    """

    options: dict[str, Any]
    train_views: int
    test_views: int
    facts: Facts
    lenses: dict[str, Any]
    points: PointsRecord | None
    stages: tuple[Stage, ...]
    columns: tuple[str, ...]
    left_out: dict[str, str]
    masked: dict[str, float] = field(default_factory=dict)

    def as_data(self) -> dict[str, Any]:
        """Plain data, for the result, whose spec has the options."""
        points = None if self.points is None else self.points.model_dump(mode="json")
        skipped = {"options", *(() if self.masked else ("masked",))}
        return {**{key: value for key, value in asdict(self).items() if key not in skipped}, "points": points}

    def lines(self) -> list[str]:
        """The plan as text, one line a fact."""
        lines = [
            f"{self.train_views} training views, {self.test_views} test views, {self.facts.points} sparse points",
            points_in_words(self.points),
            "options " + (", ".join(f"{key}={value}" for key, value in self.options.items()) or "the method's own"),
        ]
        if self.masked:
            shares = ", ".join(f"{share:.1%} of the {split} views' pixels" for split, share in self.masked.items())
            lines.append(f"excluded by masks from training and scores: {shares}")
        lines += [stage.line() for stage in self.stages]
        lines.append("scores " + (", ".join(self.columns) or "none"))
        reasons: dict[str, list[str]] = {}
        for column, reason in self.left_out.items():
            reasons.setdefault(reason, []).append(column)
        lines += [f"no {', '.join(columns)}: {reason}" for reason, columns in reasons.items()]
        return lines


def masked_shares(dataset: BenchmarkDataset) -> dict[str, float]:
    """Share of the pixels that are masked, by split; empty for a dataset without masks."""
    if not any(view.has_mask for view in dataset.views):
        return {}
    shares = {}
    for split in ("train", "test"):
        views = [view for view in dataset.views if view.split == split]
        masked = [0 if (mask := dataset.mask(view)) is None else int(np.count_nonzero(~mask)) for view in views]
        shares[split] = sum(masked) / max(1, sum(view.camera.width * view.camera.height for view in views))
    return shares


def assigned_lenses(dataset: BenchmarkDataset) -> dict[str, Any]:
    """The dataset's assignment of lenses ("assign"), and by split ("train", "test") view -> [A, F], None for an unknown
    lens; as plain data."""
    assigned = {
        split: {
            view.name: None if view.lens is None else [view.lens.aperture, view.lens.focus]
            for view in dataset.views
            if view.split == split
        }
        for split in ("train", "test")
    }
    return {"assign": dataset.assign, **assigned}


def plan_for_data(
    entry: MethodEntry,
    options: dict[str, Any],
    overrides: dict[str, Any],
    dataset: BenchmarkDataset,
    facts: Facts,
    protocol: Protocol,
    *,
    force_all: bool,
) -> DataPlan:
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
    exif = (*EXIF_COLUMNS, *EXIF_FOCUS_COLUMNS) if asked_by_exif(dataset, protocol.inputs) else ()
    if exif:
        left_out |= _no_exif(entry, stages, dataset)
        if {**options, **overrides}.get("lens_focus_from") == "exif":
            left_out |= dict.fromkeys(
                EXIF_FOCUS_COLUMNS, "training started from EXIF's focus distances: not independent"
            )
    every = (
        *protocol.refocus_columns,
        *protocol.all_in_focus_columns,
        *protocol.photograph,
        *protocol.lens,
        *exif,
        *protocol.depth,
    )
    return DataPlan(
        options={**options, **switched, **overrides},
        train_views=len(train),
        test_views=len(test),
        facts=facts,
        lenses=assigned_lenses(dataset),
        points=dataset.points_record,
        stages=tuple(stages),
        columns=tuple(column for column in every if column not in left_out),
        left_out=left_out,
        masked=masked_shares(dataset),
    )


class _Trials:
    """The A/B checks that the method would make during training, less those that the plan or the user has decided.
    force_all: none."""

    def __init__(self, card: Card, options: dict[str, Any], overrides: dict[str, Any], force_all: bool):
        self._option = card.trials
        self._before = "" if card.trials is None else str(options.get(card.trials, ""))
        decided = {stage.tried_as for stage in card.stages.values() if stage.option in overrides}
        words = [] if force_all else [word for word in self._before.split(",") if word]
        self._open = [word for word in words if word not in decided]

    def __contains__(self, word: str | None) -> bool:
        return word in self._open

    def close(self, word: str | None) -> None:
        """Drop a check whose answer is known or no longer needed."""
        self._open = [other for other in self._open if other != word]

    def switched(self) -> dict[str, str]:
        """The option as it must be, where that differs from what it was."""
        now = ",".join(self._open)
        return {} if self._option is None or now == self._before else {self._option: now}


def revised(plan: dict[str, Any], decisions: Sequence[Decision]) -> dict[str, Any]:
    """The plan, as plain data, with the decisions of the training in place of those before it, and new ones added."""
    stages = {stage["name"]: stage for stage in plan["stages"]}
    stages |= {one.stage: {"name": one.stage, "runs": one.runs, "reason": one.reason} for one in decisions}
    return {**plan, "stages": list(stages.values())}


def decided(before: Sequence[Stage], plan: dict[str, Any]) -> list[str]:
    """A line for each decision that training changed. plan: as plain data, from the result."""
    was = {stage.name: stage for stage in before}
    now = [Stage(**stage) for stage in plan["stages"]]
    return [stage.line() for stage in now if stage != was.get(stage.name)]


def _stages(
    entry: MethodEntry, options: dict[str, Any], overrides: dict[str, Any], facts: Facts, force_all: bool, sharp: bool
) -> tuple[list[Stage], dict[str, Any]]:
    """The stages, and the options that disable those that are off. sharp: trained on all-in-focus images."""
    trials = _Trials(entry.card, options, overrides, force_all)
    stages: list[Stage] = []
    switched: dict[str, Any] = {}
    runs: dict[str, bool] = {}
    for name, card in entry.card.stages_in_order():
        verdict = DECIDERS[card.decided_by](Asked(facts, sharp, runs))
        if verdict is None or not verdict.to_be_tried:
            trials.close(card.tried_as)
        tried = card.tried_as in trials
        if verdict is None or (verdict.only_tried and not tried):
            continue
        needless, why = verdict.needless and not tried, f"{verdict.why}; {TRIED}" if tried else verdict.why
        switch = card.switch
        if switch is not None and all(options.get(key) == value for key, value in switch.items()):
            runs[card.decided_by] = False  # the preset or the user has switched it off: nothing to be decided
        elif card.option in overrides:
            runs[card.decided_by] = True  # the user has decided; what else the switch sets only goes with it
        else:
            runs[card.decided_by] = not needless or force_all or switch is None
            if needless and force_all:
                why = f"--force-all; {why}"
            elif needless and switch is None:
                why = f"{entry.id} can't disable it; {why}"
            elif needless:
                switched |= switch or {}
            stages.append(Stage(name, runs[card.decided_by], why))
        if not runs[card.decided_by]:
            trials.close(card.tried_as)
    return stages, {**switched, **trials.switched()}


def _why_no_lens(entry: MethodEntry, stages: Sequence[Stage]) -> str:
    """Why the lens is disabled, or ""."""
    name = entry.card.stage_decided_by("lens")
    return next((stage.reason for stage in stages if stage.name == name and not stage.runs), "")


def _no_exif(entry: MethodEntry, stages: list[Stage], dataset: BenchmarkDataset) -> dict[str, str]:
    """Why learned lenses can't be compared with EXIF, by column; columns that can be are absent."""
    no_lens = "" if entry.card.capabilities.learns_lens else "the method learns no lens"
    if left_out := _why_no_lens(entry, stages):
        no_lens = no_lens or f"lens disabled: {left_out}"
    reasons = dict.fromkeys(EXIF_COLUMNS, no_lens or missing_exif(dataset))
    reasons |= dict.fromkeys(EXIF_FOCUS_COLUMNS, no_lens or missing_exif_focus(dataset))
    return {column: reason for column, reason in reasons.items() if reason}


def _left_out(entry: MethodEntry, protocol: Protocol, stages: list[Stage], missing: MissingTruth) -> dict[str, str]:
    capabilities = entry.card.capabilities
    refocus = missing.refocus
    if not capabilities.refocus and refocus != NO_TEST_VIEWS:
        refocus = "the method has no lens to refocus with"
    no_lens = _why_no_lens(entry, stages)
    if not capabilities.learns_lens:
        lens = "the method learns no lens"
    elif not protocol.lens:
        lens = f"{protocol.id} trains on sharp photographs, which have no lens to be learned"
    elif missing.lens:
        lens = missing.lens
    else:
        lens = f"lens disabled: {no_lens}" if no_lens else ""
    lensless = ""
    if not capabilities.refocus:
        lensless = f"{WITHOUT_LENS}: the method has no lens"
    elif no_lens:
        lensless = f"{WITHOUT_LENS}: lens disabled: {no_lens}"
    no_depth = "" if capabilities.depth else "the method renders no depth"
    unseen = "" if capabilities.trains else "the method has no pictures of training views"
    reasons = (
        (tuple(column for column in protocol.photograph if column in OF_LENSES), lensless),
        ((FIT_CEILING,) if protocol.photograph else (), unseen),
        (protocol.refocus_columns, refocus),
        (protocol.all_in_focus_columns, missing.all_in_focus),
        (LENS_COLUMNS, lens),
        (protocol.depth, missing.depth or no_depth),
        ((RESOLVED_COLUMN,), no_depth),
    )
    return {column: reason for columns, reason in reasons if reason for column in columns}
