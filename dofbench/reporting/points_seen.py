"""What methods start from: where a dataset's points and poses come from, in the words of its manifest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.evaluation.results.collecting import Entry
from dofbench.reporting.view import Table


def points_of(entries: Sequence[Entry]) -> PointsRecord | None:
    """The record of the dataset of these runs, which share it; None where no result states it."""
    return next((entry.points for entry in entries if entry.points is not None), None)


def with_points_note(table: Table, entries: Sequence[Entry]) -> Table:
    """The table of these runs on one dataset, with a line below it on what they started from."""
    return replace(table, below=(*table.below, points_in_words(points_of(entries))))


def points_facts(boards: Sequence[tuple[str, Sequence[Entry]]]) -> list[str]:
    """A line for each thing that methods may have started from, with the datasets' names. boards: (name, runs)."""
    named: dict[str, dict[str, None]] = {}
    for name, entries in boards:
        named.setdefault(points_in_words(points_of(entries)), {})[name] = None
    return [f"{', '.join(names)}: {words}" for words, names in named.items()]
