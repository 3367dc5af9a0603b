"""Each row's difference from the reference row, with a paired test."""

from __future__ import annotations

from dofbench.reporting.ablations.cells import Filled
from dofbench.reporting.differences import Compared, adjusted, compare, difference_text
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.line_table import plain
from dofbench.results.columns import COLUMNS


def differences(filled: Filled, column: str) -> dict[str, Compared]:
    """Row -> its difference from the reference in a column, p adjusted over the rows.

    Raises ValueError for a table without a reference row.
    """
    reference = filled.plan.table.reference
    if reference is None:
        raise ValueError("differences: expected a table with a reference row, found none")
    others = [row for row in filled.rows if row != reference]
    raw = [
        compare([(filled.runs(row, dataset), filled.runs(reference, dataset)) for dataset in filled.datasets], column)
        for row in others
    ]
    return dict(zip(others, adjusted(raw), strict=True))


def difference_cells(filled: Filled, notes: Footnotes) -> tuple[list[str], list[list[str]]]:
    """(columns in which any row has a difference, the rows' cells)."""
    found = {column: differences(filled, column) for column in filled.plan.table.columns}
    columns = [column for column, rows in found.items() if any(one.difference for one in rows.values())]
    rows = [row for row in filled.rows if row != filled.plan.table.reference]
    cells = []
    for row in rows:
        texts = []
        for column in columns:
            compared = found[column][row]
            texts.append(
                f"–{notes.mark(compared.reason)}"
                if compared.difference is None
                else difference_text(compared.difference, COLUMNS[column])
            )
        cells.append([plain(row), *texts])
    return columns, cells
