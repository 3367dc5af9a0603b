"""Tables of a large report with a row for each scene, whose name leads to its pages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from dofbench.evaluation.results.collecting import grouped
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import arithmetic_mean
from dofbench.reporting.boards import Board, Variant, best_texts, united
from dofbench.reporting.overview import HEADLINES
from dofbench.reporting.tables import Heading, Table, gap, score, word_headings, words

ACROSS = 12  # methods in the columns of a table


def scene_scores(boards: Sequence[Board], links: Mapping[Variant, str]) -> Iterator[Table]:
    """For each kind of board and PSNR the scores of every scene, by method. links: board -> the folder of its pages."""
    for kind, scenes in grouped(boards, "kind").items():
        for column in (one for columns in HEADLINES for one in columns):
            ranked = _ranked(scenes, column)
            if ranked:
                yield _table(kind, scenes, column, ranked, links)


def _ranked(scenes: Sequence[Board], column: str) -> list[Variant]:
    """The variants with a score, those with one of most scenes first, and of these the best."""
    values: dict[Variant, list[float]] = {}
    for board in scenes:
        for variant, line in board.lines.items():
            value = line.cells[column].value if column in line.cells else None
            if value is not None and math.isfinite(value):
                values.setdefault(variant, []).append(value)
    return sorted(values, key=lambda one: (-len(values[one]), -arithmetic_mean(values[one]), one))


def _table(
    kind: str, scenes: Sequence[Board], column: str, ranked: Sequence[Variant], links: Mapping[Variant, str]
) -> Table:
    known, shown = COLUMNS[column], ranked[:ACROSS]
    lines = {variant: line for board in scenes for variant, line in board.lines.items()}
    rows = []
    for board in scenes:
        best = best_texts(list(board.lines.values()), [column])[column]
        own = [board.lines.get(variant) for variant in shown]
        scores = [gap("not run") if one is None else score(one.cells[column], known, best) for one in own]
        name = words(board.name, united(line.signs for line in board.lines.values()))
        rows.append((replace(name, link=links[board.key]), *scores))
    headings = [Heading(lines[one].name, known.heading, known.note, bool(known.higher_is_better)) for one in shown]
    said = f"{len(shown)} of {len(ranked)} methods, the best; `leaderboard.csv` has all."
    return Table(
        f"{known.label} of each scene, {kind}",
        (*word_headings("dataset"), *headings),
        tuple(rows),
        below=(said,) if len(shown) < len(ranked) else (),
        rest="leaderboard.csv",
    )
