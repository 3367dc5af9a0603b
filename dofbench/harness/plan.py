"""What a run will do and what it leaves out, with the reason: plain data, decided before anything runs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from dofbench.contracts import Budget
from dofbench.errors import InputError
from dofbench.harness.methods import MethodEntry
from dofbench.harness.protocol import LENS_COLUMNS, Protocol
from dofbench.harness.settings import format_budget
from dofbench.synthesis.dataset import Dataset

NEEDLESS_COC = 0.5  # px: a disc of less than a pixel's width is the pixel, so such a lens does nothing
NO_TEST_VIEWS = "the dataset has no test views"


@dataclass(frozen=True)
class Stage:
    """A part of the method that the data may or may not need. runs: what was decided."""

    name: str
    runs: bool
    reason: str


@dataclass(frozen=True)
class RunPlan:
    """Printed by --dry-run and stored in the result.

    budget: as `--budget` takes it. options: what the method is created with. largest_coc_px: of the
    photographs that the method trains on. lenses: as `dealt_lenses`. columns: scores that will be measured.
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
    largest_coc_px: float
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
            f"largest CoC radius {self.largest_coc_px:.2f} px",
            "options " + (", ".join(f"{key}={value}" for key, value in self.options.items()) or "the method's own"),
        ]
        lines += [f"stage {stage.name}: {'runs' if stage.runs else 'left out'}: {stage.reason}"
                  for stage in self.stages]
        lines.append("scores " + (", ".join(self.columns) or "none"))
        reasons: dict[str, list[str]] = {}
        for column, reason in self.left_out.items():
            reasons.setdefault(reason, []).append(column)
        lines += [f"no {', '.join(columns)}: {reason}" for reason, columns in reasons.items()]
        return lines


def dealt_lenses(dataset: Dataset) -> dict[str, Any]:
    """How the dataset deals its lenses ("assign"), and per split ("train", "test") view -> [A, F], as plain data."""
    dealt = {
        split: {view.name: [view.lens.aperture, view.lens.focus] for view in dataset.views if view.split == split}
        for split in ("train", "test")
    }
    return {"assign": dataset.assign, **dealt}


def make_plan(
    entry: MethodEntry, preset: str, options: dict[str, Any], overrides: dict[str, Any], budget: Budget,
    dataset: Dataset, protocol: Protocol, *, seed: int, device: str, force_all: bool,
) -> RunPlan:
    """Decide from the dataset and the method's card.

    options: the preset's; overrides: the user's, which win over what the plan sets. force_all: every
    stage runs, needed or not. Raises InputError when the dataset lacks what the method can't do without.
    """
    train = [view for view in dataset.views if view.split == "train"]
    test = [view for view in dataset.views if view.split == "test"]
    if not train:
        raise InputError(f"dataset {dataset.name}", "no training view", "at least one")
    has_points = dataset.has_points
    if entry.card.capabilities.needs_points and not has_points:
        raise InputError(f"dataset {dataset.name}", "no sparse points", f"some, as {entry.id} starts from them")

    sharp = protocol.inputs == "all-in-focus"
    largest = 0.0 if sharp else max(view.max_coc_px for view in train)
    stages, switched = [], {}
    if entry.card.capabilities.learns_lens:
        needless = "the training photographs are sharp" if sharp else (
            f"the largest CoC radius is {largest:.2f} px, below {NEEDLESS_COC} px" if largest < NEEDLESS_COC else "")
        needed = f"the largest CoC radius is {largest:.2f} px"
        stages.append(_decide("lens", needless, needed, entry, force_all, switched))
    if entry.card.capabilities.needs_points or "sparse_depth" in entry.card.leave_out:
        needless = "" if has_points else "the dataset has no sparse points"
        stages.append(_decide("sparse_depth", needless, "the dataset has sparse points", entry, force_all, switched))

    left_out = _left_out(entry, protocol, stages, bool(test)) | _no_depth_errors(dataset, protocol, bool(test))
    every = (*protocol.refocus_columns, *protocol.all_in_focus_columns, *protocol.lens, *protocol.depth)
    return RunPlan(
        method=entry.id, preset=preset, dataset=dataset.name, protocol=protocol.id, budget=format_budget(budget),
        seed=seed, device=device, options={**options, **switched, **overrides},
        train_views=len(train), test_views=len(test), largest_coc_px=float(largest), lenses=dealt_lenses(dataset),
        stages=tuple(stages),
        columns=tuple(column for column in every if column not in left_out), left_out=left_out,
    )


def _decide(
    name: str, needless: str, needed: str, entry: MethodEntry, force_all: bool, switched: dict[str, Any],
) -> Stage:
    """One stage; adds the options that switch it off to `switched`. needless: why it could be left out."""
    if not needless:
        return Stage(name, True, needed)
    if force_all:
        return Stage(name, True, f"--force-all, although {needless}")
    switch = entry.card.leave_out.get(name)
    if switch is None:
        return Stage(name, True, f"{entry.id} can't leave it out, although {needless}")
    switched.update(switch)
    return Stage(name, False, needless)


def _left_out(entry: MethodEntry, protocol: Protocol, stages: list[Stage], has_test_views: bool) -> dict[str, str]:
    capabilities = entry.card.capabilities
    left_out: dict[str, str] = {}
    if not has_test_views:
        left_out.update(dict.fromkeys((*protocol.refocus_columns, *protocol.all_in_focus_columns), NO_TEST_VIEWS))
    elif not capabilities.refocus:
        left_out.update(dict.fromkeys(protocol.refocus_columns, f"{entry.card.name} has no lens to refocus with"))
    lens_stage = next((stage for stage in stages if stage.name == "lens"), None)
    if not capabilities.learns_lens:
        reason = f"{entry.card.name} learns no lens"
    elif not protocol.lens:
        reason = f"{protocol.id} trains on sharp photographs, which have no lens to be learned"
    elif lens_stage is not None and not lens_stage.runs:
        reason = f"the lens was left out: {lens_stage.reason}"
    else:
        return left_out
    left_out.update(dict.fromkeys(LENS_COLUMNS, reason))
    return left_out


def _no_depth_errors(dataset: Dataset, protocol: Protocol, has_test_views: bool) -> dict[str, str]:
    if not has_test_views:
        return dict.fromkeys(protocol.depth, NO_TEST_VIEWS)
    if dataset.has_exact_depth:
        return {}
    return dict.fromkeys(protocol.depth, "the dataset's own depth is an estimate, no truth to compare with")
