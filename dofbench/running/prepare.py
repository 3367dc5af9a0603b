"""A run decided, and nothing of it done yet: what --dry-run prints, and what its result is kept by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.contracts import Method
from dofbench.core.errors import InputError
from dofbench.dataset.benchmark_dataset import BenchmarkDataset
from dofbench.dataset.dataset import Dataset
from dofbench.dataset.inputs import Inputs
from dofbench.results import provenance
from dofbench.results.protocol import Protocol, protocol_for
from dofbench.results.result import RESULT_FILE, Result, Spec, read_result
from dofbench.results.run_spec import Run, parse_overrides
from dofbench.running.facts import Facts, facts_of
from dofbench.running.method_cards import MethodEntry, find_method
from dofbench.running.plan import RunPlan, make_plan
from dofbench.scoring.ground_truth import photograph_columns


@dataclass(frozen=True)
class Choices:
    """What the call alone decides, whatever the dataset."""

    entry: MethodEntry
    preset: str
    options: dict[str, Any]
    overrides: dict[str, Any]
    budget: Budget
    device: str


@dataclass(frozen=True, eq=False)
class Prepared:
    """A run to be made. data: the dataset's folder. method: created, not trained. folder: where its
    result goes."""

    settings: Run
    choices: Choices
    dataset: BenchmarkDataset
    data: Path
    protocol: Protocol
    plan: RunPlan
    spec: Spec
    method: Method
    folder: Path

    def finished(self) -> Result | None:
        """The result of the same run, if it is there and running again would only repeat it."""
        if not (self.folder / RESULT_FILE).is_file():
            return None
        earlier = read_result(self.folder)
        return earlier if earlier.key == self.spec.key and earlier.finished else None


def choose(settings: Run) -> Choices:
    """Method, preset, budget and device. Raises InputError when the call is wrong."""
    entry = find_method(settings.method)
    preset, options, budget = entry.preset(settings.preset, builtin=settings.data is None)
    overrides = parse_overrides(settings.set)
    budget = _budget(settings, budget, {**options, **overrides}, f"preset {preset} of {entry.id}")
    return Choices(entry, preset, options, overrides, budget, entry.device_for(settings.device))


def prepare(settings: Run, choices: Choices, data: Path) -> Prepared:
    """Decide the rest from the dataset in `data`. Raises InputError when that is none, or the method doesn't know
    an option."""
    dataset = Dataset.load(data)
    entry = choices.entry
    protocol = protocol_for(settings.inputs, photographs=photograph_columns(dataset))
    facts = _facts(data.resolve(), dataset.checksum, settings.inputs)
    plan = make_plan(
        entry,
        choices.preset,
        choices.options,
        choices.overrides,
        choices.budget,
        dataset,
        facts,
        protocol,
        seed=settings.seed,
        device=choices.device,
        force_all=settings.force_all,
    )
    spec = Spec(
        method=entry.id,
        preset=choices.preset,
        overrides=choices.overrides,
        options=plan.options,
        budget=str(plan.budget),
        dataset=dataset.name,
        dataset_checksum=dataset.checksum,
        protocol=protocol.id,
        seed=settings.seed,
        device=choices.device,
        code=provenance.code_version(entry.folder),
    )
    method = entry.create(dict(plan.options), settings.seed, choices.device)  # raises for an unknown option
    return Prepared(settings, choices, dataset, data, protocol, plan, spec, method, settings.out / spec.folder)


@lru_cache(maxsize=64)
def _facts(folder: Path, checksum: str, inputs: Inputs) -> Facts:
    """Facts of a dataset, which many runs in one call may share. checksum: so that it is the same one still."""
    dataset = Dataset.load(folder)
    one_lens = None if dataset.assign == "unknown" else dataset.assign == "fixed"
    return facts_of(dataset.training_set(inputs), one_lens=one_lens)


def _budget(settings: Run, preset: Budget | None, options: dict, subject: str) -> Budget:
    """The call's budget, else the preset's, else the preset's option `steps`."""
    if settings.budget is not None:
        return settings.budget
    if preset is not None:
        return preset
    steps = options.get("steps")
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
        found = "neither budget nor steps" if steps is None else f"steps = {steps!r}"
        raise InputError(subject, found, "a budget, or steps above zero, or --budget on the command line")
    return Budget(steps=steps)
