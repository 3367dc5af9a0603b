"""The runs of an ablation that have ended: means and differences from the reference row, and its CSV files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.comparing.means import Statistic, scene_mean, seed_mean
from dofbench.evaluation.comparing.paired import Compared, adjusted, compare
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.run_spec import option_words
from dofbench.running.ablation_plan import TablePlan
from dofbench.running.ablation_tables import of_scene
from dofbench.running.ended_runs import Ended

NOT_RUN = Statistic(None, failure="not run yet", reason="rerun the same command to resume")
CELL_COLUMNS = "table row dataset seed column value status method preset options budget role".split()
SUMMARY_COLUMNS = """table row dataset seeds column mean sd status paper difference difference_sd p pairs
    difference_low difference_high verdict""".split()


@dataclass(frozen=True)
class Filled:
    """A table with its runs that have ended. seeds: those for which every cell has ended; if there is none, the first
    seed. entries: (row, dataset, seed) -> the run."""

    plan: TablePlan
    seeds: tuple[int, ...]
    entries: dict[tuple[str, str, int], Entry]

    @property
    def rows(self) -> list[str]:
        """Labels of the rows."""
        return [row.label for row in self.plan.table.rows]

    @property
    def datasets(self) -> list[str]:
        """Labels of the datasets."""
        return [source.label for source in self.plan.sources]

    def runs(self, row: str, dataset: str) -> list[Entry]:
        """The row's runs on a dataset; empty unless every seed has ended."""
        found = [self.entries.get((row, dataset, seed)) for seed in self.seeds]
        return [entry for entry in found if entry is not None] if None not in found else []

    def value(self, row: str, dataset: str, seed: int, column: str) -> float | None:
        """One run's score; None without one."""
        entry = self.entries.get((row, dataset, seed))
        return entry.scores.get(column) if entry is not None and entry.status == "ok" else None

    def cell(self, row: str, dataset: str, column: str) -> Statistic:
        """Mean and sample standard deviation over the seeds."""
        runs = self.runs(row, dataset)
        return seed_mean(runs, column) if runs else NOT_RUN

    def mean_cell(self, row: str, column: str) -> Statistic:
        """The mean over datasets and seeds, with the standard deviation of the mean over datasets over the seeds; a gap
        unless every dataset and seed has a value."""
        found = {dataset: self.cell(row, dataset, column) for dataset in self.datasets}
        return scene_mean(found, self.datasets, [self.runs(row, dataset) for dataset in self.datasets], column)

    @cached_property
    def tested(self) -> str:
        """The column in which rows are tested: the first in which one can be compared with the reference."""
        columns = self.plan.table.columns
        return next((one for one in columns if any(row.difference for row in self._compared(one).values())), columns[0])

    def differences(self, column: str) -> dict[str, Compared]:
        """Row -> its difference from the reference row in a column, with p in the tested one, adjusted over the rows;
        empty without a reference."""
        found = self._compared(column, test=column == self.tested)
        return dict(zip(found, adjusted(list(found.values())), strict=True))

    def _compared(self, column: str, *, test: bool = False) -> dict[str, Compared]:
        reference = self.plan.table.reference
        if reference is None:
            return {}
        return {
            row: compare(
                [(self.runs(row, dataset), self.runs(reference, dataset)) for dataset in self.datasets],
                column,
                test=test,
            )
            for row in self.rows
            if row != reference
        }


def fill(plan: TablePlan, ended: Ended) -> Filled:
    """The table with those of its runs that have ended."""
    entries = {place: entry for place, run in plan.runs.items() if (entry := ended.find(run)) is not None}
    seeds = sorted({seed for _, _, seed in plan.runs})
    whole = [seed for seed in seeds if all(place in entries for place in plan.runs if place[2] == seed)]
    return Filled(plan, tuple(whole or seeds[:1]), entries)


# ---- CSV files ----


def cell_rows(filled: Filled) -> Iterator[dict[str, object]]:
    """One row per run and score. value is empty without a score: then status is how the run ended, or "not run".
    options: those that the run changes of its preset."""
    roles = {source.label: source.role or ROLE_NOT_STATED for source in filled.plan.sources}
    for place, run in filled.plan.runs.items():
        entry, spec = filled.entries.get(place), run.spec
        status = "not run" if entry is None else str(entry.status)
        made = status, spec.method, spec.preset, " ".join(option_words(spec.overrides)), spec.budget, roles[place[1]]
        for column in filled.plan.table.columns:
            values = (filled.plan.table.id, *place, column, filled.value(*place, column), *made)
            yield dict(zip(CELL_COLUMNS, values, strict=True))


def summary_rows(filled: Filled) -> Iterator[dict[str, object]]:
    """One row per cell of the page, with the paper's figure for that scene; dataset "mean": over all datasets, with the
    paper's mean on its data, and the difference from the reference row as on the page."""
    declared, seeds = filled.plan.table, " ".join(map(str, filled.seeds))
    scenes = {source.label: source.scene for source in filled.plan.sources}
    for column in declared.columns:
        found = filled.differences(column)
        for row in declared.rows:
            means = [(dataset, filled.cell(row.label, dataset, column)) for dataset in filled.datasets]
            for dataset, cell in (*means, ("mean", filled.mean_cell(row.label, column))):
                missing = "not run" if cell is NOT_RUN else cell.failure or "no such score"
                scores = cell.value, cell.spread, missing if cell.value is None else "ok"
                values = (declared.id, row.label, dataset, seeds, column, *scores)
                record: dict[str, object] = dict(zip(SUMMARY_COLUMNS, values, strict=False))
                theirs = row.paper if dataset == "mean" else of_scene(row.paper_scenes, scenes[dataset])
                record["paper"] = theirs.get(column)
                if dataset == "mean":
                    compared = found.get(row.label)
                    if compared is not None and (one := compared.difference) is not None:
                        record |= {"difference": one.mean, "difference_sd": one.spread, "p": one.p, "pairs": one.pairs}
                        record |= {"difference_low": one.low, "difference_high": one.high, "verdict": compared.verdict}
                yield record
