"""The whole page: sections in their order, with styles, scripts, data and pictures inside."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from dofbench import __version__
from dofbench.core.content import content_folder
from dofbench.reporting.html.boards import Board, gather
from dofbench.reporting.html.details import board_sections, column_notes, run_table, stage_table
from dofbench.reporting.html.html_ablations import Ablation, ablation_sections
from dofbench.reporting.html.layouts import layout_sections
from dofbench.reporting.html.markup import Notes
from dofbench.reporting.html.overview import headline, overview
from dofbench.reporting.html.pictures import Gallery, gallery
from dofbench.reporting.html.time_page import plot_data, plot_tables
from dofbench.reporting.plots import Plot
from dofbench.reporting.reach import RULE
from dofbench.reporting.timing import FRONT_RULE, TIME_RULE, level_words
from dofbench.results.collecting import Collection
from dofbench.scoring.error_maps import FULL_SCALE
from dofbench.scoring.resolved import FULL_SCALE as RESOLVED_SCALE

SCRIPTS = ("report.js", "sort.js", "chart.js", "compare.js")
_MARK = re.compile(r"\{\{(\w+)\}\}")


@dataclass(frozen=True)
class _Section:
    """id: of the anchor. short: in the navigation."""

    id: str
    short: str
    title: str
    html: str


def report_page(
    collection: Collection, plots: Sequence[Plot], ablations: list[Ablation], *, pictures: bool = True
) -> str:
    """The page as text. The same results and pictures give the same text."""
    boards = gather(collection.entries)
    notes = Notes()
    shown = gallery(boards) if pictures else Gallery([], "")
    sections = [section for section in _sections(collection, boards, plots, ablations, shown, notes) if section.html]
    if footnotes := notes.html():
        sections.append(_Section("notes", "Notes", "Notes", footnotes))
    parts = {
        "title": f"dofbench report: {headline(collection)}",
        "headline": escape(headline(collection)),
        "version": escape(__version__),
        "css": _template("report.css"),
        "js": "\n".join(_template(name) for name in SCRIPTS),
        "navigation": "".join(f'<li><a href="#{one.id}">{escape(one.short)}</a></li>' for one in sections),
        "sections": "\n".join(
            f'<section id="{one.id}"><h2>{escape(one.title)}</h2>{one.html}</section>' for one in sections
        ),
        "data": _script_data({"plots": plot_data(plots), "pictures": shown.data}),
    }
    return _MARK.sub(lambda mark: parts[mark[1]], _template("report.html"))


def _sections(
    collection: Collection,
    boards: list[Board],
    plots: Sequence[Plot],
    ablations: list[Ablation],
    shown: Gallery,
    notes: Notes,
) -> list[_Section]:
    return [
        _Section("overview", "At a glance", "At a glance", overview(collection, boards, notes)),
        _Section("tables", "Tables", "Tables, as the paper lays them out", "".join(layout_sections(boards, notes))),
        _Section("time", "Error against time", "Error against run time", _time(plots)),
        _Section("pictures", "Pictures", "Truth, prediction, error", _pictures(shown)),
        _Section("ablations", "Ablations", "What each part is worth", ablation_sections(ablations, notes)),
        _Section("datasets", "Every score", "Every score, dataset by dataset", board_sections(boards, notes)),
        _Section(
            "runs",
            "Runs",
            "How it was made",
            (
                f"<details open><summary>Command, code and machine of each run</summary>{run_table(collection, boards)}"
                f"</details><details><summary>Where the time went</summary>{stage_table(collection, boards)}</details>"
                f"<details><summary>What the columns say</summary>{column_notes()}</details>"
            ),
        ),
    ]


def _time(plots: Sequence[Plot]) -> str:
    if not plots:
        return ""
    return f"""
<p>{escape(TIME_RULE)}. One line a run, with a mark at every moment that was scored; several seeds are thin lines,
and their median a thick one in steps, as no score is interpolated. The broad grey line is the Pareto front; dotted
lines are the levels of the table below.</p>
<div class="controls">
<label>Dataset and protocol <select id="plot-board"></select></label>
<label>Score <select id="plot-score"></select></label>
<label class="tick"><input type="checkbox" id="plot-log"> score on a log axis</label>
</div>
<div class="card"><div id="chart"></div>
<ul class="legend" id="plot-legend" aria-label="Curves, to switch on and off"></ul></div>
<p class="caption" id="plot-note"></p>
{plot_tables(plots)}
<p class="caption">{escape(RULE)} {escape(level_words(plots))} {escape(FRONT_RULE)}.</p>"""


def _pictures(shown: Gallery) -> str:
    if not shown.data:
        return f"<p>{escape(shown.said)}</p>" if shown.said else ""
    selects = "".join(
        f'<label>{label} <select id="picture-{name}"></select></label>'
        for name, label in (
            ("board", "Dataset and protocol"),
            ("view", "Test view"),
            ("kind", "Rendered"),
            ("left", "Left of the slider"),
            ("right", "Right of it"),
        )
    )
    return f"""
<div class="controls">{selects}</div>
<div class="card">
<p class="missing" id="picture-missing" hidden></p>
<div class="compare" id="compare"><img class="left" alt=""><img class="right" alt="">
<div class="bar"></div><div class="tag left"><span></span></div><div class="tag right"><span></span></div>
<input type="range" min="0" max="100" value="50" step="1"
 aria-label="Where the left picture ends and the right one begins"></div>
<div class="scale" id="picture-scale" hidden>error 0 <i></i> {FULL_SCALE:g} or more, mean over R, G, B</div>
<p class="caption" id="picture-resolved" hidden>Resolved: light where some training photograph saw the surface in focus,
dark where all of them saw it through circles of confusion of {RESOLVED_SCALE:g} px or more or not at all, black where
the method has no surface. What is dark is the method's invention as much as a measurement.</p>
<div class="scroll" tabindex="0" role="region" aria-label="Scores of this view">
<table id="picture-scores"></table></div>
</div>
<p class="caption">{escape(shown.said)}</p>"""


def _template(name: str) -> str:
    return (content_folder("reports/templates") / name).read_text(encoding="utf-8")


def _script_data(data: object) -> str:
    """JSON that can stand inside a script element: no tag can end it early."""
    return json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
