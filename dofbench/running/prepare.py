"""Deciding a run: what the call says, what the dataset adds, and the method made ready; nothing is done yet."""

from __future__ import annotations

from dataclasses import asdict, dataclass, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.clock import loading
from dofbench.core.contracts import Method
from dofbench.core.lens import framed_alike
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.inputs import Inputs
from dofbench.evaluation.results import provenance
from dofbench.evaluation.results.protocol import Protocol, protocol_for
from dofbench.evaluation.results.result import RESULT_FILE, Result, Spec, read_result
from dofbench.evaluation.results.run_spec import Run, parse_overrides
from dofbench.evaluation.scoring.ground_truth import photograph_columns
from dofbench.methods.cards import MethodEntry, find_method, preset_budget
from dofbench.methods.frozen_presets import choices_digest
from dofbench.methods.stages.facts import Facts, facts_of
from dofbench.running.plan import make_plan
from dofbench.running.planned_runs import PlannedRun
from dofbench.training.common.options import content_digests


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
    """A planned run with all that it takes to make it. method: created, not trained."""

    planned: PlannedRun
    entry: MethodEntry
    dataset: BenchmarkDataset
    protocol: Protocol
    method: Method

    def finished(self) -> Result | None:
        """The result of the same run, if it is there and running again would only repeat it."""
        folder = self.planned.folder
        if not (folder / RESULT_FILE).is_file():
            return None
        earlier = read_result(folder)
        return earlier if earlier.key == self.planned.spec.key and earlier.finished else None


def choose(settings: Run) -> Choices:
    """Method, preset, budget and device. Raises InputError when the call is wrong."""
    entry = find_method(settings.method)
    device = entry.device_for(settings.device)
    preset, options, budget = entry.preset(settings.preset, builtin=settings.data is None, device=device)
    overrides = parse_overrides(settings.set)
    budget = settings.budget or preset_budget(entry, preset, {**options, **overrides}, budget)
    return Choices(entry, preset, options, overrides, budget, device)


def prepare(settings: Run, data: Path) -> Prepared:
    """Decide a run on the dataset in `data`. The time that this takes counts as `loading`: the method's modules are
    imported.

    Raises InputError when the call is wrong, the folder is no dataset, or the method doesn't know an option.
    """
    with loading.running():
        choices = choose(settings)
        return _prepare(settings, choices, data)


def plan_run(settings: Run, data: Path) -> PlannedRun:
    """What `prepare` decides. Raises InputError as it does."""
    return prepare(settings, data).planned


def _prepare(settings: Run, choices: Choices, data: Path) -> Prepared:
    dataset = Dataset.load(data)
    entry = choices.entry
    protocol = protocol_for(settings.inputs, photographs=photograph_columns(dataset))
    facts = _facts(data.resolve(), dataset.checksum, settings.inputs)
    plan = make_plan(entry, choices.options, choices.overrides, dataset, facts, protocol, force_all=settings.force_all)
    method = entry.create(dict(plan.options), settings.seed, choices.device)  # raises for an unknown option
    options = getattr(method, "options", None)
    spec = Spec(
        method=entry.id,
        preset=choices.preset,
        overrides=choices.overrides,
        options=plan.options,
        budget=str(choices.budget),
        dataset=dataset.name,
        dataset_checksum=dataset.checksum,
        protocol=protocol.id,
        seed=settings.seed,
        device=choices.device,
        code=provenance.code_version(entry.folder, choices.device),
        content=content_digests(options),
    )
    known = asdict(options) if is_dataclass(options) and not isinstance(options, type) else spec.options
    pixels = [view.camera.width * view.camera.height for view in dataset.training_views()]
    planned = PlannedRun(
        settings=settings,
        data=data,
        spec=spec,
        budget=choices.budget,
        plan=plan,
        folder=settings.out / spec.folder,
        options=known,
        view_pixels=sum(pixels) / len(pixels),
        choices=choices_digest(entry, {**choices.options, **choices.overrides}, choices.budget, settings.force_all),
    )
    return Prepared(planned, entry, dataset, protocol, method)


@lru_cache(maxsize=64)
def _facts(folder: Path, checksum: str, inputs: Inputs) -> Facts:
    """Facts of a dataset, which many runs in one call may share. checksum: so that it is the same one still."""
    dataset = Dataset.load(folder)
    one_lens = None
    if dataset.assign != "unknown":  # an aperture in units of the width is one opening on cameras that are alike
        one_lens = dataset.assign == "fixed" and framed_alike(view.camera for view in dataset.training_views())
    return facts_of(dataset.training_set(inputs), one_lens=one_lens)
