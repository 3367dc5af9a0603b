"""Each row's difference from the reference row, with a paired test."""

from __future__ import annotations

from dofbench.ablation.cells import Filled
from dofbench.reporting.columns import COLUMNS, Column
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.line_table import plain
from dofbench.reporting.paired import SIGNIFICANT, Difference, holm, paired_difference


def differences(filled: Filled, column: str) -> dict[str, Difference | None]:
    """Row -> its difference from the reference in a column, p adjusted over the rows; None where a pair is missing.

    Raises ValueError for a table without a reference row.
    """
    reference = filled.plan.table.reference
    if reference is None:
        raise ValueError("differences: expected a table with a reference row, found none")
    others = [row for row in filled.rows if row != reference]
    raw = {row: None if (pairs := filled.pairs(row, reference, column)) is None else paired_difference(pairs)
           for row in others}
    adjusted = holm([None if one is None else one.p for one in raw.values()])
    return {
        row: None if one is None else Difference(one.pairs, one.mean, one.spread, p)
        for (row, one), p in zip(raw.items(), adjusted, strict=True)
    }


def difference_cells(filled: Filled, notes: Footnotes) -> tuple[list[str], list[list[str]]]:
    """(columns in which any row has a difference, the rows' cells)."""
    found = {column: differences(filled, column) for column in filled.plan.table.columns}
    columns = [column for column, rows in found.items() if any(one is not None for one in rows.values())]
    rows = [row for row in filled.rows if row != filled.plan.table.reference]
    gap = "a run of the pair lacks this score: see the tables of the datasets"
    cells = []
    for row in rows:
        texts = []
        for column in columns:
            difference = found[column][row]
            texts.append(f"–{notes.mark(gap)}" if difference is None else difference_text(difference, COLUMNS[column]))
        cells.append([plain(row), *texts])
    return columns, cells


def difference_text(difference: Difference, column: Column) -> str:
    """As "+0.31 ± 0.05, p = 0.003, better"; the verdict only where the test bears it."""
    number = f"{difference.mean:+.{column.digits}f}"
    text = number if difference.spread is None else f"{number} ± {column.text(difference.spread)}"
    if difference.p is None:
        return text
    text += ", p < 0.001" if difference.p < 0.001 else f", p = {difference.p:.3f}"
    if difference.p >= SIGNIFICANT or float(number) == 0:  # what can't be seen in the table is no better
        return text
    if column.higher_is_better is None:
        return f"{text}, {'more' if difference.mean > 0 else 'less'}"
    return f"{text}, **{'better' if (difference.mean > 0) is column.higher_is_better else 'worse'}**"
