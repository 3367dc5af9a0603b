"""The content of an ablation table's CSV files: every run's scores, and their means, spreads and differences."""

from __future__ import annotations

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.evaluation.results.run_spec import option_words
from dofbench.reporting.ablations.filled_table import NOT_RUN, Filled
from dofbench.reporting.ablations.row_differences import differences
from dofbench.reporting.records import Records
from dofbench.reporting.summary import Statistic

CELLS = (
    "table",
    "row",
    "dataset",
    "seed",
    "column",
    "value",
    "status",
    "method",
    "preset",
    "options",
    "budget",
    "role",
)
SUMMARY = (
    "table",
    "row",
    "dataset",
    "seeds",
    "column",
    "mean",
    "sd",
    "status",
    "paper",
    "difference",
    "difference_sd",
    "p",
    "pairs",
    "difference_low",
    "difference_high",
    "verdict",
)
MEAN = "mean"  # in place of the dataset, in rows that average over all datasets


def cell_records(filled: Filled) -> Records:
    """One row per run and score. value is empty without a score: then status says how the run ended, or "not run".
    options: those that the run changes of its preset."""
    rows = []
    roles = {source.label: source.role or ROLE_NOT_STATED for source in filled.plan.sources}
    for (row, dataset, seed), run in filled.plan.runs.items():
        entry = filled.entries.get((row, dataset, seed))
        for column in filled.plan.table.columns:
            rows.append(
                {
                    "table": filled.plan.table.id,
                    "row": row,
                    "dataset": dataset,
                    "seed": seed,
                    "column": column,
                    "value": filled.value(row, dataset, seed, column),
                    "status": "not run" if entry is None else str(entry.status),
                    "method": run.spec.method,
                    "preset": run.spec.preset,
                    "options": " ".join(option_words(run.spec.overrides)),
                    "budget": run.spec.budget,
                    "role": roles[dataset],
                }
            )
    return Records(f"{filled.plan.table.id}.csv", CELLS, tuple(rows))


def summary_records(filled: Filled) -> Records:
    """One row per cell of the page. paper: the paper's mean, on the paper's data. The difference is that from the
    reference row, over the views of all datasets (for a cost, over the seeds), with p and interval as on the page."""
    declared = filled.plan.table
    paper = {row.label: row.paper for row in declared.rows}
    rows = []
    for column in declared.columns:
        found = differences(filled, column) if declared.reference is not None else {}
        for row in filled.rows:
            for dataset in filled.datasets:
                rows.append(_row(filled, row, dataset, column, filled.cell(row, dataset, column)))
            mean = _row(filled, row, MEAN, column, filled.mean_cell(row, column)) | {"paper": paper[row].get(column)}
            if row in found and (difference := found[row].difference) is not None:
                mean |= {
                    "difference": difference.mean,
                    "difference_sd": difference.spread,
                    "p": difference.p,
                    "pairs": difference.pairs,
                    "difference_low": difference.low,
                    "difference_high": difference.high,
                    "verdict": found[row].verdict,
                }
            rows.append(mean)
    return Records(f"{declared.id}-summary.csv", SUMMARY, tuple(rows))


def _row(filled: Filled, row: str, dataset: str, column: str, cell: Statistic) -> dict[str, object]:
    status = "ok" if cell.value is not None else "not run" if cell is NOT_RUN else cell.failure or "no such score"
    return {
        "table": filled.plan.table.id,
        "row": row,
        "dataset": dataset,
        "column": column,
        "seeds": " ".join(map(str, filled.seeds)),
        "mean": cell.value,
        "sd": cell.spread,
        "status": status,
    }
