"""leaderboard.md: which parts of a report it contains, and in which order."""

from __future__ import annotations

from collections.abc import Sequence

from dofbench.reporting.markdown_writer import markdown_page
from dofbench.reporting.report_view import BoardView, CurveView, ReportView
from dofbench.reporting.view import Block, Document, Paragraph, Section

_INTRODUCTION = """\
Best in bold, which alone doesn't make it better: see the differences below each table. Where runs differ
only in their seed, a cell is mean ± sample standard deviation over the n seeds; without ±, there was one, and
no spread is known. A cell that a method can't have is –, with the reason below; a run that failed shows how. Results
of different protocols, or of different versions of a dataset, never share a table. Report scenes come first, and
are never averaged with development scenes; within both, photographs through a lens come before those by a formula. The
do-nothing line is what a predictor of the lens scores that learns nothing; an error above it is worse than no
learning."""


def leaderboard_markdown(view: ReportView) -> str:
    """The page. The explanation of times and Pareto fronts stands with the first board's curves."""
    blocks: list[Block] = [Paragraph(_INTRODUCTION), Section("At a glance", (view.best,))]
    for index, board in enumerate(view.boards):
        blocks.append(_board(board, (view.curve_rules,) if index == 0 else ()))
    blocks += view.means
    if view.mean_curves:
        blocks.append(Section("Means over scenes against run time", _timed(view.mean_curves)))
    blocks += [part for part in (view.tested, view.claims, view.columns, view.added) if part]
    blocks.append(Section("How these were made", (view.runs, view.machines)))
    if view.unreadable.items:
        blocks.append(Section("Results that can't be read", (view.unreadable,)))
    return markdown_page(Document("leaderboard", "Leaderboard", tuple(blocks)))


def _board(board: BoardView, rules: tuple[Paragraph, ...]) -> Section:
    strip = (board.strip,) if board.strip is not None else ()
    parts = (board.differences, board.asked)
    timed = Section("Error against run time", (*rules, *_timed(board.curves), *strip))
    return Section(board.title, (board.about, board.scores, *(part for part in parts if part is not None), timed))


def _timed(curves: Sequence[CurveView]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for curve in curves:
        blocks += [curve.picture] if curve.picture is not None else []
        blocks += [Paragraph(curve.front_words)] if curve.front_words else []
        blocks += [curve.reach] if curve.reach is not None else []
    return tuple(blocks)
