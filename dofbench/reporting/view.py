"""The whole content of a report as plain data for the templates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dofbench.evaluation.comparing.paired import EXPLANATION
from dofbench.evaluation.comparing.pairwise import Pair, Variant, with_the_best
from dofbench.evaluation.comparing.photograph_notes import photograph_notes
from dofbench.evaluation.comparing.score_curves import Point
from dofbench.evaluation.results.collecting import Collection, grouped, variant_names
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.evaluation.scoring.resolved import FULL_SCALE as RESOLVED_SCALE
from dofbench.reporting import layouts, overview, sections
from dofbench.reporting.boards import Board, score_columns
from dofbench.reporting.curves import Plot, Series
from dofbench.reporting.pairs import HEADING, TESTED
from dofbench.reporting.pictures import BoardPictures
from dofbench.reporting.tables import Section, Table
from dofbench.reporting.timing import CurveView, curve_rules


@dataclass(frozen=True)
class BoardView:
    """One dataset under one protocol. strip: file of truth, predictions and errors as one picture, "" without."""

    section: Section
    curves: tuple[CurveView, ...]
    strip: str


@dataclass(frozen=True)
class ReportView:
    """The whole content of a report, for the templates.

    headline: one line. best: the best over scenes and of each board. facts: (term, lines). boards, means, mean_curves:
    every score, by dataset and as means over scenes, with their curves. layouts: tables as the paper lays them out.
    explanations: how differences are tested, published figures; columns: explanations of the scores. added: scores that
    were computed after the runs. runs, machines, stages: how each run was made. gallery: pictures of the test views.
    """

    headline: str
    best: Table
    facts: tuple[tuple[str, tuple[str, ...]], ...]
    boards: tuple[BoardView, ...]
    means: tuple[Section, ...]
    mean_curves: tuple[CurveView, ...]
    curve_rules: str
    layouts: tuple[Section, ...]
    explanations: tuple[Section, ...]
    columns: Section
    added: tuple[Section, ...]
    runs: Table
    machines: tuple[str, ...]
    stages: Table
    unreadable: tuple[str, ...]
    gallery: Sequence[BoardPictures] = ()
    ablations: Sequence[Section] = ()

    @property
    def curves(self) -> tuple[CurveView, ...]:
        """All curves in the page's order, in which its script knows them too."""
        return (*self.mean_curves, *(curve for board in self.boards for curve in board.curves))


def build_view(
    collection: Collection,
    boards: Sequence[Board],
    *,
    pairs: Mapping[Variant, Sequence[Pair]],
    of_means: Mapping[str, Sequence[Pair]],
    curves: Sequence[CurveView] = (),
    mean_curves: Sequence[CurveView] = (),
    strips: Mapping[Variant, str] = {},
    gallery: Sequence[BoardPictures] = (),
    ablations: Sequence[Section] = (),
) -> ReportView:
    """The content of a report. pairs: `pairwise` of each board, by its key. of_means: `mean_pairs`. strips: board ->
    file of its strip of pictures. gallery: pictures of test views."""
    entries = collection.entries
    columns, names = score_columns(entries), variant_names(entries)
    several = {board.key for scenes in grouped(boards, "kind").values() if len(scenes) > 1 for board in scenes}
    views = []
    for board in boards:
        own = with_the_best(pairs[board.key], len(board.variants)) if board.key in several else pairs[board.key]
        timed = tuple(curve for curve in curves if curve.plot.board == board.key)
        section = sections.board_section(board, columns, names, own)
        section = replace(section, text=(*section.text, *photograph_notes(board.variants, entries, names)))
        views.append(BoardView(section, timed, strips.get(board.key, "")))
    runs, machines = sections.run_table(entries, boards)
    compared = any(one.title == HEADING for view in views for one in view.section.sections)
    tested, claims = Section(TESTED, (EXPLANATION,)) if compared else None, sections.claims_section(entries)
    return ReportView(
        headline=overview.headline(collection),
        best=overview.best_table(boards, pairs, of_means),
        facts=overview.facts(collection, boards),
        boards=tuple(views),
        means=sections.mean_sections(boards, columns, names, of_means),
        mean_curves=tuple(mean_curves),
        curve_rules=curve_rules([curve.plot for curve in (*curves, *mean_curves)]),
        layouts=layouts.layout_sections(boards),
        explanations=tuple(section for section in (tested, claims) if section is not None),
        columns=sections.column_section(columns),
        added=tuple(filter(None, (sections.added_section(entries),))),
        runs=runs,
        machines=machines,
        stages=sections.stage_table(entries, boards),
        unreadable=collection.unreadable,
        gallery=gallery,
        ablations=ablations,
    )


def page_data(view: ReportView) -> dict[str, Any]:
    """What the page's script reads, and the scales of its pictures."""
    plots = [plot_data(curve.plot) for curve in view.curves]
    return {"data": {"plots": plots}, "full_scale": FULL_SCALE, "resolved_scale": RESOLVED_SCALE}


def plot_data(plot: Plot) -> dict[str, Any]:
    """A plot for the script that draws it: the curves, and the labels of axes and values."""
    return {
        "board": plot.title,
        "column": plot.column,
        "label": plot.score.label,
        "heading": plot.score.heading,
        "unit": plot.score.unit,
        "clock": plot.clock,
        "digits": plot.score.digits,
        "higher": plot.higher_is_better,
        "note": plot.score.note,
        "nothing": plot.nothing,
        "levels": list(plot.levels),
        "series": [_series_data(series) for series in plot.series],
        "front": [[_short(point.time), _short(point.score), point.series] for point in plot.front],
    }


def _series_data(series: Series) -> dict[str, Any]:
    return {
        "name": series.label,
        "place": series.place,
        "failures": series.failures,
        "runs": [{"seed": run.seed, "points": _points(run.points), "dropped": run.dropped} for run in series.runs],
        "median": _points(series.median) if len(series.runs) > 1 else [],
    }


def _points(points: Sequence[Point]) -> list[list[float]]:
    return [[_short(time), _short(score)] for time, score in points]


def _short(value: float) -> float:
    """The value rounded to six digits: more are invisible, and would double the size of the page."""
    return float(f"{value:.6g}")
