"""The scores of a table's runs: means and spreads of its rows, dataset by dataset and over all datasets."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.protocol import arithmetic_mean
from dofbench.reporting import standing
from dofbench.reporting.summary import Line, Statistic, scene_mean, seed_mean
from dofbench.running.ablation_plan import TablePlan
from dofbench.running.ended_runs import Ended

NOT_RUN = Statistic(None, failure="not run yet", reason="the same command goes on with it")


@dataclass(frozen=True)
class Filled:
    """A table with its runs that have ended.

    seeds: those for which every cell has ended; if there is none, the first seed. entries: (row, dataset, seed) -> the
    run.
    """

    plan: TablePlan
    seeds: tuple[int, ...]
    entries: dict[tuple[str, str, int], Entry]

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels of the rows."""
        return tuple(row.label for row in self.plan.table.rows)

    @property
    def datasets(self) -> tuple[str, ...]:
        """Labels of the datasets."""
        return tuple(source.label for source in self.plan.sources)

    def cell(self, row: str, dataset: str, column: str) -> Statistic:
        """Mean and sample standard deviation over the seeds."""
        found = [self.entries.get((row, dataset, seed)) for seed in self.seeds]
        ended = [entry for entry in found if entry is not None]
        return seed_mean(ended, column) if len(ended) == len(found) else NOT_RUN

    def lines(self, dataset: str) -> list[Line]:
        """The rows on one dataset."""
        columns = self.plan.table.columns
        return [
            self._line(row, {column: self.cell(row, dataset, column) for column in columns}, (dataset,))
            for row in self.rows
        ]

    def signs(self, row: str, datasets: tuple[str, ...]) -> str:
        """What the row's runs on these datasets don't prove (`dofbench.reporting.standing`)."""
        roles = {source.label: source.role for source in self.plan.sources}
        return standing.united(
            standing.signs(roles[place[1]], [entry])
            for place, entry in self.entries.items()
            if place[0] == row and place[1] in datasets
        )

    def mean_lines(self) -> list[Line]:
        """The rows as means over the datasets. The spread is the standard deviation of this mean over the seeds."""
        columns = self.plan.table.columns
        return [
            self._line(row, {column: self.mean_cell(row, column) for column in columns}, self.datasets)
            for row in self.rows
        ]

    def mean_cell(self, row: str, column: str) -> Statistic:
        """The mean over datasets and seeds; a gap unless every dataset and seed has a value."""
        lines = {dataset: self._line(row, {column: self.cell(row, dataset, column)}, ()) for dataset in self.datasets}
        mean = scene_mean(lines, list(self.datasets), column)
        values = [[self.value(row, dataset, seed, column) for dataset in self.datasets] for seed in self.seeds]
        means = [arithmetic_mean(one) for one in values if None not in one]  # type: ignore[arg-type]
        if mean.value is None or len(means) < 2 or not all(map(math.isfinite, means)):
            return mean
        return Statistic(mean.value, statistics.stdev(means))

    def value(self, row: str, dataset: str, seed: int, column: str) -> float | None:
        """One run's score; None without one."""
        entry = self.entries.get((row, dataset, seed))
        return entry.scores.get(column) if entry is not None and not self._failed(entry) else None

    def runs(self, row: str, dataset: str) -> list[Entry]:
        """The row's runs on a dataset; empty unless every seed has ended."""
        found = [self.entries.get((row, dataset, seed)) for seed in self.seeds]
        return [entry for entry in found if entry is not None] if None not in found else []

    def _line(self, row: str, cells: dict[str, Statistic], datasets: tuple[str, ...]) -> Line:
        return Line(row, "", ", ".join(map(str, self.seeds)), cells, signs=self.signs(row, datasets))

    @staticmethod
    def _failed(entry: Entry) -> bool:
        return entry.status != "ok"


def fill(plan: TablePlan, ended: Ended) -> Filled:
    """The table with those of its runs that have ended."""
    entries = {place: entry for place, run in plan.runs.items() if (entry := ended.find(run)) is not None}
    seeds = sorted({seed for _, _, seed in plan.runs})
    whole = [seed for seed in seeds if all(place in entries for place in plan.runs if place[2] == seed)]
    return Filled(plan, tuple(whole or seeds[:1]), entries)
