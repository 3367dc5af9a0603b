"""Each row's difference from the reference row, with a paired test."""

from __future__ import annotations

from dofbench.reporting.ablations.filled_table import Filled
from dofbench.reporting.differences import Compared, adjusted, compare


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
