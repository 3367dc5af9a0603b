"""Differences between runs, column by column: which values are paired, and the verdict on the difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS, COST
from dofbench.evaluation.results.protocol import LENS_COLUMNS
from dofbench.reporting.paired import Difference, Group, grouped_difference, holm

Side = Sequence[Entry]  # the seeds of one variant on one dataset


@dataclass(frozen=True)
class Compared:
    """Comparison of two sides in one column. difference: None if it can't be computed, for the `reason`."""

    column: str
    difference: Difference | None
    reason: str = ""

    @property
    def verdict(self) -> str:
        """better or worse (for a cost, more or less), or "" if the difference isn't significant. All verdicts come from
        this rule."""
        if self.difference is None or not self.difference.telling:
            return ""
        up, known = self.difference.mean > 0, COLUMNS[self.column]
        if known.higher_is_better is None:
            return "more" if up else "less"
        return "better" if up is known.higher_is_better else "worse"


def compare(groups: Sequence[tuple[Side, Side]], column: str) -> Compared:
    """Compare one side's runs with the other's in a column, paired by view; for a cost, which has no views, by seed.

    groups: the two sides' seeds on each dataset. Every run must have ended well and have the score for the same views;
    otherwise there is no difference.
    """
    pairs: list[Group] = []
    for one, other in groups:
        found = _by_seed(one, other, column) if column in COST else _by_view(one, other, column)
        if isinstance(found, str):
            return Compared(column, None, found)
        pairs.append(found)
    difference = grouped_difference(pairs)
    if column in COST:  # costs are paired by seed
        difference = replace(difference, seeds=min(len(one) for one, _ in groups))
    return Compared(column, difference)


def adjusted(compared: Sequence[Compared]) -> list[Compared]:
    """The comparisons with p adjusted for their number."""
    p = holm([one.difference.p if one.difference else None for one in compared])
    return [
        one if one.difference is None else replace(one, difference=replace(one.difference, p=value))
        for one, value in zip(compared, p, strict=True)
    ]


def _by_view(one: Side, other: Side, column: str) -> Group | str:
    sides, names = [], []
    for entries in (one, other):
        rows = [_values(entry, column) for entry in entries]
        if not rows or any(row is None for row in rows):
            return "a run of the pair failed, or lacks this score"
        sides.append(rows)
        names += [sorted(row) for row in rows if row is not None]
    if any(name != names[0] for name in names) or not names[0]:
        return "the two have no scores of the same views"
    first, second = (np.array([[row[name] for name in names[0]] for row in rows if row is not None]) for rows in sides)
    return first, second


def _by_seed(one: Side, other: Side, column: str) -> Group | str:
    found = []
    for entries in (one, other):
        if any(entry.status is not Status.OK or column not in entry.scores for entry in entries):
            return "a run of the pair failed, or lacks this score"
        found.append({entry.spec.seed: entry.scores[column] for entry in entries})
    if found[0].keys() != found[1].keys() or not found[0]:
        return "the two were not run with the same seeds"
    first, second = (np.array([[values[seed] for seed in sorted(values)]]) for values in found)
    return first, second


def _values(entry: Entry, column: str) -> dict[str, float] | None:
    """View -> value of a run; None unless it has a value for every view."""
    if entry.status is not Status.OK or entry.result is None or column not in COLUMNS:
        return None
    if column in LENS_COLUMNS:
        return {view.name: getattr(view, column) for view in entry.result.lens} or None
    views = entry.views
    if not views or any(column not in scores for scores in views.values()):
        return None
    return {name: scores[column] for name, scores in views.items()}
