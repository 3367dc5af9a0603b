"""Which runs the tables need: plain data, decided before anything runs."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError
from dofbench.core.evidence import Photographer, Role
from dofbench.core.files import canonical_json, sha256_text
from dofbench.datasets.format.assignment import Assignment
from dofbench.evaluation.results.columns import lens_words
from dofbench.evaluation.results.run_spec import RunSpec, parse_overrides
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_tables import TUNING, Declaration, Row, Table, chosen_tables
from dofbench.running.data_plan import assigned_lenses
from dofbench.running.plan import Plan, different_datasets, make_plan


@dataclass(frozen=True)
class Source:
    """A dataset of the call. label: its name, with the folder's where two have one name. lenses: what its views were
    made with, in words. role, photographer: what its scores are evidence of (`dofbench.core.evidence`)."""

    folder: Path
    label: str
    scene: str
    assign: Assignment
    lenses: str
    role: Role | None
    photographer: Photographer


@dataclass(frozen=True)
class TablePlan:
    """A table with its datasets. runs: (row's label, dataset's label, seed) -> the run; equal runs are one object."""

    table: Table
    sources: tuple[Source, ...]
    runs: dict[tuple[str, str, int], Plan]


@dataclass(frozen=True)
class AblationPlan:
    """tables: what will be written. runs: every run once, all of seed 0 first. skipped: tables without a dataset."""

    tables: tuple[TablePlan, ...]
    runs: tuple[Plan, ...]
    skipped: tuple[str, ...]


def plan_tables(settings: Ablate, declaration: Declaration) -> AblationPlan:
    """Decide every run of the call.

    Raises InputError for a table, an option, a preset or a dataset that doesn't fit, before anything runs.
    """
    sources = _sources(settings.folders)
    shared = parse_overrides(settings.set)
    runs: dict[str, Plan] = {}
    plans: list[TablePlan] = []
    skipped: list[str] = []
    for table in chosen_tables(declaration, settings.ids):
        own = tuple(source for source in sources if source.assign in table.assign)
        report = [source.label for source in own if source.role == "report"]
        if table.id == TUNING and report:
            if table.id in settings.ids:
                raise InputError(f"table {TUNING}", f"{report[0]}, a report scene", "development scenes to tune on")
            skipped.append(f"skipping table {TUNING}: {report[0]} is a test scene, on which nothing is tuned")
            continue
        if not own:
            wanted = f"made with --assign {' or '.join(one for one in table.assign if one != 'unknown')}"
            if table.id in settings.ids:
                raise InputError(f"table {table.id}", "no dataset for it in --data", f"one that was {wanted}")
            skipped.append(f"skipping table {table.id}: needs a dataset {wanted}")
            continue
        cells: dict[tuple[str, str, int], Plan] = {}
        for row in table.rows:
            for source in own:
                first = _run(settings, declaration, table, row, source, shared)
                for seed in range(settings.seeds):
                    run = first.with_seed(seed)
                    cells[row.label, source.label, seed] = runs.setdefault(_what_runs(run), run)
        plans.append(TablePlan(table, own, cells))
    ordered = sorted(runs.values(), key=lambda run: run.spec.seed)  # stable: tables and rows keep their order
    return AblationPlan(tuple(plans), tuple(ordered), tuple(skipped))


def _run(
    settings: Ablate,
    declaration: Declaration,
    table: Table,
    row: Row,
    source: Source,
    shared: dict[str, Any],
) -> Plan:
    """The run of seed 0."""
    run = RunSpec(
        method=row.method or declaration.method,
        data=source.folder,
        preset=row.preset or settings.preset,
        set=tuple(f"{key}={_toml(value)}" for key, value in {**shared, **row.set}.items()),
        budget=settings.budget,
        device=settings.device,
        out=settings.results,
        inputs=table.inputs,
        force_all=row.force_all,
    )
    try:
        return make_plan(run, source.folder)
    except InputError as error:
        raise InputError(f"table {table.id}, row {row.label}: {error.subject}", error.found, error.expected) from None


def _what_runs(run: Plan) -> str:
    """Equal for two runs that do the same, even if one says an option that the other has anyway."""
    rest = run.spec.model_dump(mode="json", exclude={"overrides", "preset", "options"})
    return sha256_text(canonical_json({**rest, "options": run.options}))


def _toml(value: Any) -> str:
    """The shortest text that `--set` reads back as `value`."""
    if isinstance(value, str) and parse_overrides((f"x={value}",)) == {"x": value}:
        return value
    return json.dumps(value)


def _sources(folders: tuple[Path, ...]) -> tuple[Source, ...]:
    """Raises InputError for a folder that is no dataset, or given twice."""
    datasets = different_datasets(folders)
    names = Counter(dataset.name for dataset in datasets)
    found = []
    for folder, dataset in zip(folders, datasets, strict=True):
        alone = names[dataset.name] == 1
        label = dataset.name if alone else f"{dataset.name} ({folder})"
        lenses = lens_words(assigned_lenses(dataset))
        found.append(Source(folder, label, dataset.scene, dataset.assign, lenses, dataset.role, dataset.photographer))
    roles = {source.role for source in found}
    if "report" in roles and len(roles) > 1:
        other = next(source.label for source in found if source.role != "report")
        raise InputError("--data", f"report scenes and {other}", "scenes of one role, as a table averages over them")
    return tuple(found)
