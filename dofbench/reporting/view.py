"""The whole content of a report as plain data for the templates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dofbench.evaluation.comparing.paired import EXPLANATION
from dofbench.evaluation.comparing.pairwise import Pair, Variant, with_the_best
from dofbench.evaluation.comparing.photograph_notes import photograph_notes
from dofbench.evaluation.comparing.score_curves import Point
from dofbench.evaluation.results.collecting import Collection, Entry, grouped
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.evaluation.scoring.resolved import FULL_SCALE as RESOLVED_SCALE
from dofbench.reporting import layouts, overview, sections
from dofbench.reporting.boards import Board, Names, score_columns
from dofbench.reporting.curves import Plot, Series
from dofbench.reporting.pairs import HEADING, TESTED
from dofbench.reporting.pictures import BoardPictures
from dofbench.reporting.scene_tables import scene_scores
from dofbench.reporting.tables import Section, Table
from dofbench.reporting.timing import CurveView, curve_rules

_FACTS = 8  # lines of a fact about many runs


@dataclass(frozen=True)
class BoardView:
    """One dataset under one protocol. strip: file of truth, predictions and errors as one picture, "" without."""

    section: Section
    curves: tuple[CurveView, ...]
    strip: str


@dataclass(frozen=True)
class Scene:
    """A dataset with pages of its own. folder: theirs, as seen from the overview. curves: whether they show curves."""

    name: str
    folder: str
    curves: bool


@dataclass(frozen=True)
class ReportView:
    """The whole content of a set of pages, for the templates.

    headline: one line. best: the best over scenes and of each board. facts: (term, lines). boards, means, mean_curves:
    every score, by dataset and as means over scenes, with their curves. layouts: tables as the paper lays them out.
    explanations: how differences are tested, published figures; columns: explanations of the scores. added: scores that
    were computed after the runs. runs, machines, stages: how each run was made, None on an overview. gallery: pictures
    of the test views. name: of the dataset that the pages are about, "" for all. scenes, by_scene: on an overview, the
    datasets with pages of their own, and tables with a row for each.
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
    runs: Table | None
    machines: tuple[str, ...]
    stages: Table | None
    unreadable: tuple[str, ...]
    gallery: Sequence[BoardPictures] = ()
    ablations: Sequence[Section] = ()
    name: str = ""
    scenes: tuple[Scene, ...] = ()
    by_scene: tuple[Table, ...] = ()

    @property
    def curves(self) -> tuple[CurveView, ...]:
        """All curves in the page's order, in which its script knows them too."""
        return (*self.mean_curves, *(curve for board in self.boards for curve in board.curves))


def build_view(
    collection: Collection,
    boards: Sequence[Board],
    names: Names,
    *,
    pairs: Mapping[Variant, Sequence[Pair]],
    of_means: Mapping[str, Sequence[Pair]] = {},
    curves: Sequence[CurveView] = (),
    mean_curves: Sequence[CurveView] = (),
    strips: Mapping[Variant, str] = {},
    gallery: Sequence[BoardPictures] = (),
    ablations: Sequence[Section] = (),
    most: int,
    others: Sequence[Entry] = (),
    name: str = "",
) -> ReportView:
    """The content of pages about these runs. names: of the variants in the whole report. pairs: `pairwise` of each
    board, by its key. of_means: `mean_pairs`. strips: board -> file of its strip of pictures. gallery: pictures of test
    views. most: rows of a table. others: all runs of the report where these are of one dataset, of this `name`."""
    entries = collection.entries
    columns, by_scene = score_columns(entries), grouped(others or entries, "scene")
    several = {board.key for scenes in grouped(boards, "kind").values() if len(scenes) > 1 for board in scenes}
    timed = grouped(curves, "board")
    views = []
    for board in boards:
        own = with_the_best(pairs[board.key], len(board.variants)) if board.key in several else pairs[board.key]
        section = sections.board_section(board, columns, names, own)
        notes = photograph_notes(board.variants, by_scene[board.scene], names)
        section = replace(section, text=(*section.text, *notes)).first(most)
        views.append(BoardView(section, tuple(timed.get(board.key, ())), strips.get(board.key, "")))
    runs, machines = sections.run_table(entries, boards)
    compared = any(one.title == HEADING for view in views for one in view.section.sections)
    headline = overview.headline(collection)
    return ReportView(
        headline=f"{name} · {headline}" if name else headline,
        best=overview.best_table(boards, pairs, of_means).first(most),
        facts=overview.facts(collection, boards, _FACTS if len(entries) > most else None),
        boards=tuple(views),
        means=tuple(one.first(most) for one in sections.mean_sections(boards, columns, names, of_means)),
        mean_curves=tuple(mean_curves),
        curve_rules=curve_rules([curve.plot for curve in (*curves, *mean_curves)]),
        layouts=tuple(one.first(most) for one in layouts.layout_sections(boards)),
        explanations=_explanations(entries, compared),
        columns=sections.column_section(columns),
        added=tuple(filter(None, (sections.added_section(entries),))),
        runs=runs.first(most),
        machines=machines,
        stages=sections.stage_table(entries, boards).first(most),
        unreadable=collection.unreadable,
        gallery=gallery,
        ablations=ablations,
        name=name,
    )


def build_overview(
    collection: Collection,
    boards: Sequence[Board],
    names: Names,
    scenes: Mapping[Variant, Scene],
    *,
    pairs: Mapping[Variant, Sequence[Pair]],
    of_means: Mapping[str, Sequence[Pair]],
    mean_curves: Sequence[CurveView],
    ablations: Sequence[Section],
    most: int,
) -> ReportView:
    """The content of pages above those of the datasets: what is over scenes, and the best of each. scenes: board -> the
    dataset's pages; else as `build_view`."""
    entries, columns = collection.entries, score_columns(collection.entries)
    means = tuple(one.first(most) for one in sections.mean_sections(boards, columns, names, of_means))
    compared = any(one.title == HEADING for section in means for one in section.sections)
    links = {board: scene.folder for board, scene in scenes.items()}
    best = overview.scene_table(boards, pairs, links)
    return ReportView(
        headline=overview.headline(collection),
        best=overview.mean_table(boards, of_means),
        facts=overview.facts(collection, boards, _FACTS),
        boards=(),
        means=means,
        mean_curves=tuple(mean_curves),
        curve_rules=curve_rules([curve.plot for curve in mean_curves]),
        layouts=tuple(one.first(most) for one in layouts.layout_sections(boards, by_scene=False)),
        explanations=_explanations(entries, compared),
        columns=sections.column_section(columns),
        added=tuple(filter(None, (sections.added_section(entries),))),
        runs=None,
        machines=sections.machine_lines(entries),
        stages=None,
        unreadable=collection.unreadable,
        ablations=ablations,
        scenes=tuple(sorted(set(scenes.values()), key=lambda scene: scene.name)),
        by_scene=tuple(table.first(most) for table in (*scene_scores(boards, links), best)),
    )


def _explanations(entries: Sequence[Entry], compared: bool) -> tuple[Section, ...]:
    """How differences are tested, if any is shown, and the figures that authors published."""
    tested, claims = Section(TESTED, (EXPLANATION,)) if compared else None, sections.claims_section(entries)
    return tuple(section for section in (tested, claims) if section is not None)


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
