"""The plan of a run: plain data, decided before anything runs. No method is built for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.clock import planning
from dofbench.core.contracts import ReadsOptions
from dofbench.core.errors import InputError
from dofbench.core.lens import framed_alike
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.inputs import Inputs
from dofbench.evaluation.results import provenance
from dofbench.evaluation.results.protocol import protocol_for
from dofbench.evaluation.results.result import Spec
from dofbench.evaluation.results.run_spec import RunSpec, parse_overrides
from dofbench.evaluation.scoring.ground_truth import photograph_columns
from dofbench.methods.cards import MethodEntry, find_method, preset_budget
from dofbench.methods.frozen_presets import choices_digest
from dofbench.methods.stages.facts import Facts, facts_of
from dofbench.running.data_plan import DataPlan, plan_for_data
from dofbench.running.kept_facts import kept_facts
from dofbench.running.training_log import check_logger
from dofbench.training.common.options import content_digests


@dataclass(frozen=True)
class Choices:
    """The part of a plan that depends on the command line alone."""

    entry: MethodEntry
    preset: str
    options: dict[str, Any]
    overrides: dict[str, Any]
    budget: Budget
    device: str

    def check_options(self) -> None:
        """Raise InputError for an option that the method doesn't have, or a wrong value."""
        _read_options(self.entry, {**self.options, **self.overrides})


@dataclass(frozen=True)
class Plan:
    """A run that is to be made.

    settings: the options of `dofbench run` for this run alone. data: the dataset's folder. spec: all that decides the
    result. by_data: what the dataset decides. folder: of the result. options: all options of the method with their
    defaults, where it can list them; else those of the spec. view_pixels: mean of the training views. choices: digest
    of preset and command line (`dofbench.methods.frozen_presets`).
    """

    settings: RunSpec
    data: Path
    spec: Spec
    budget: Budget
    by_data: DataPlan
    folder: Path
    options: dict[str, Any]
    view_pixels: float
    choices: str
    scene: str

    @property
    def name(self) -> str:
        """Dataset, method, preset, seed and key, for a line of progress."""
        return str(self.spec.folder)

    def lines(self) -> list[str]:
        """All decisions, one line each."""
        spec, (views, *rest) = self.spec, self.by_data.lines()
        what = f"{spec.method} ({spec.preset}, seed {spec.seed}, {spec.device}) on {spec.dataset}, {spec.protocol}"
        held_out = f"; {spec.held_out:.1%} of the training views' pixels held out" if spec.held_out else ""
        return [what, f"budget {self.budget}; {views}{held_out}", *rest]

    def summary(self) -> list[str]:
        """The plan in at most five lines, without an estimate of the time."""
        spec, by_data = self.spec, self.by_data
        return [
            f"method   {spec.method}, preset {spec.preset}, seed {spec.seed}, on {spec.device}",
            f"dataset  {spec.dataset}: {by_data.train_views} training views, {by_data.test_views} test views",
            f"budget   {self.budget}",
            f"output   {self.folder}",
        ]

    def with_seed(self, seed: int) -> Plan:
        """The same run with another seed; nothing else depends on it."""
        spec = self.spec.model_copy(update={"seed": seed})
        return replace(
            self, settings=replace(self.settings, seed=seed), spec=spec, folder=self.settings.out / spec.folder
        )

    def check_unchanged(self, entry: MethodEntry, dataset: Dataset) -> None:
        """Raise InputError where code or data changed since the plan was made."""
        code = provenance.code_version(entry.folder, self.spec.device)
        if (code, dataset.checksum) != (self.spec.code, self.spec.dataset_checksum):
            found = "code or data that changed since the run was planned"
            raise InputError(self.folder, found, "the same; rerun the command")


def choose(run: RunSpec) -> Choices:
    """Method, preset, budget and device of a run. Raises InputError when the call is wrong."""
    check_logger(run.log)
    entry = find_method(run.method)
    device = entry.device_for(run.device)
    preset, options, budget = entry.preset(run.preset, builtin=run.data is None, device=device)
    overrides = parse_overrides(run.set)
    budget = run.budget or preset_budget(entry, preset, {**options, **overrides}, budget)
    return Choices(entry, preset, options, overrides, budget, device)


def make_plan(run: RunSpec, data: Path) -> Plan:
    """Plan a run on the dataset in `data`. The time counts as `planning`, but for imports of the method's modules.

    Raises InputError when the call is wrong, the folder is no dataset, or the method doesn't know an option.
    """
    with planning.running():
        return _make_plan(run, choose(run), data)


def _make_plan(run: RunSpec, chosen: Choices, data: Path) -> Plan:
    dataset, entry = Dataset.load(data), chosen.entry
    protocol = protocol_for(run.inputs, photographs=photograph_columns(dataset))
    facts = _facts(data.resolve(), dataset.checksum, run.inputs, run.held_out)
    by_data = plan_for_data(entry, chosen.options, chosen.overrides, dataset, facts, protocol, force_all=run.force_all)
    options = _read_options(entry, by_data.options)
    spec = Spec(
        method=entry.id,
        preset=chosen.preset,
        overrides=chosen.overrides,
        options=by_data.options,
        budget=str(chosen.budget),
        dataset=dataset.name,
        dataset_checksum=dataset.checksum,
        protocol=protocol.id,
        seed=run.seed,
        device=chosen.device,
        code=provenance.code_version(entry.folder, chosen.device),
        content=content_digests(options),
        held_out=run.held_out,
    )
    pixels = [view.camera.width * view.camera.height for view in dataset.training_views()]
    return Plan(
        settings=run,
        data=data,
        spec=spec,
        budget=chosen.budget,
        by_data=by_data,
        folder=run.out / spec.folder,
        options=asdict(options) if is_dataclass(options) and not isinstance(options, type) else spec.options,
        view_pixels=sum(pixels) / len(pixels),
        choices=choices_digest(entry, {**chosen.options, **chosen.overrides}, chosen.budget, run.force_all),
        scene=dataset.scene,
    )


def _read_options(entry: MethodEntry, options: dict[str, Any]) -> Any:
    """The method's options with their defaults; None of a method that can't read them before it is built."""
    kind = entry.method_class()
    return kind.read_options(options) if isinstance(kind, ReadsOptions) else None


def different_datasets(folders: Sequence[Path]) -> list[Dataset]:
    """The datasets in these folders. Raises InputError for a folder that is none, or one dataset given twice."""
    datasets = [Dataset.load(folder) for folder in folders]
    for checksum, times in Counter(dataset.checksum for dataset in datasets).items():
        if times > 1:
            double = next(folder for folder, one in zip(folders, datasets, strict=True) if one.checksum == checksum)
            raise InputError("--data", f"{double} {times} times", "every dataset once")
    return datasets


@lru_cache(maxsize=64)
def _facts(folder: Path, checksum: str, inputs: Inputs, held_out: float) -> Facts:
    """Facts of a dataset, which many runs in one call may share. checksum: so that it is the same one still."""
    return kept_facts(checksum, inputs, held_out, lambda: _look(folder, inputs, held_out))


def _look(folder: Path, inputs: Inputs, held_out: float) -> Facts:
    dataset = Dataset.load(folder)
    one_lens = None
    if dataset.assign != "unknown":  # an aperture in units of the width is one opening on cameras that are alike
        one_lens = dataset.assign == "fixed" and framed_alike(view.camera for view in dataset.training_views())
    return facts_of(dataset.training_set(inputs, held_out=held_out), one_lens=one_lens)
