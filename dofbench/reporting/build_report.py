"""Builds a report from results as plain data, which all writers use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dofbench.evaluation.results.collecting import Collection, variant_names
from dofbench.reporting import layouts, leaderboard, overview, report_records, timing
from dofbench.reporting.boards import Board, by_kind, score_columns
from dofbench.reporting.gallery import BoardPictures
from dofbench.reporting.how_made import run_table, stage_table
from dofbench.reporting.pairwise import board_pairs, comparison_records, explanation, mean_pairs, with_the_best
from dofbench.reporting.plots import Plot
from dofbench.reporting.report_view import CurveView, ReportView
from dofbench.reporting.view import Document, Items, Picture

Key = tuple[str, ...]  # identifies a board


def build_report(
    collection: Collection,
    boards: Sequence[Board],
    plots: Sequence[Plot],
    *,
    means: Sequence[Plot],
    drawn: Mapping[tuple[Key, str], Picture],
    strips: Mapping[Key, Picture],
    against: Sequence[str] = (),
    ablations: Sequence[Document] = (),
    pictures: tuple[BoardPictures, ...] | None = None,
) -> ReportView:
    """The content of a report of these results. boards: as `gather` gives them. means: `mean_plots`. drawn: (board,
    score) -> picture of the curves. strips: board -> strip of pictures. against: methods that all are compared with.
    pictures: those of test views, None for a
    report without pictures."""
    entries = collection.entries
    columns, names = score_columns(entries), variant_names(entries)
    pairs = {board.key: board_pairs(board.members, against) for board in boards}
    of_means = mean_pairs(boards, against)

    def curve(plot: Plot) -> CurveView:
        return timing.curve_view(plot, drawn.get((plot.board, plot.column)))

    curves = [(plot, curve(plot)) for plot in plots]
    several = {board.key for scenes in by_kind(boards).values() if len(scenes) > 1 for board in scenes}
    shown = dict(pairs) | {
        board.key: with_the_best(pairs[board.key], len(board.variants)) for board in boards if board.key in several
    }
    views = tuple(
        leaderboard.board_view(
            board,
            columns,
            names,
            shown[board.key],
            tuple(view for plot, view in curves if plot.board == board.key),
            strips.get(board.key),
        )
        for board in boards
    )
    runs, machines = run_table(entries, boards)
    compared = any(view.differences for view in views)
    return ReportView(
        headline=overview.headline(collection),
        best=overview.best_table(boards),
        facts=overview.facts(collection, boards),
        boards=views,
        means=leaderboard.mean_sections(boards, columns, names, of_means),
        mean_curves=tuple(curve(plot) for plot in means),
        layouts=layouts.layout_sections(boards),
        tested=explanation() if compared else None,
        claims=leaderboard.claims_section(entries),
        columns=leaderboard.column_section(columns),
        added=leaderboard.added_section(entries),
        runs=runs,
        stages=stage_table(entries, boards),
        machines=machines,
        unreadable=Items(collection.unreadable),
        curve_rules=timing.curve_rules((*plots, *means)),
        gallery=pictures,
        ablations=tuple(ablations),
        records=(
            report_records.run_records(entries),
            report_records.view_records(entries),
            report_records.curve_records(entries),
            comparison_records(boards, pairs, of_means, names),
            timing.reach_records(plots),
            timing.front_records((*plots, *means)),
            report_records.time_records(entries),
        ),
    )
