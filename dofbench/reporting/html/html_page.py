"""The whole page: the parts of a report in their order, with styles, scripts, data and pictures inside."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from html import escape

from dofbench import __version__
from dofbench.core.content import content_folder
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.evaluation.scoring.resolved import FULL_SCALE as RESOLVED_SCALE
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.html.html_blocks import blocks_html, items_html, notes_html, paragraph_html, table_html
from dofbench.reporting.html.packed_pictures import Packed, packed
from dofbench.reporting.html.plot_data import plot_data
from dofbench.reporting.report_view import BoardView, CurveView, ReportView
from dofbench.reporting.view import Block, Document, Section

SCRIPTS = ("report.js", "sort.js", "chart.js", "compare.js")
_MARK = re.compile(r"\{\{(\w+)\}\}")


@dataclass(frozen=True)
class _Section:
    """A section of the page. id: of its anchor. short: its name in the navigation."""

    id: str
    short: str
    title: str
    html: str


def report_page(view: ReportView) -> str:
    """The page as text. The same report and pictures give the same text."""
    notes = Footnotes()
    shown = packed(view.gallery) if view.gallery is not None else Packed([], "")
    sections = [section for section in _sections(view, shown, notes) if section.html]
    if footnotes := notes_html(notes):
        sections.append(_Section("notes", "Notes", "Notes", footnotes))
    plots = [curve.plot for curve in _curves(view)]
    parts = {
        "title": f"dofbench report: {escape(view.headline)}",
        "headline": escape(view.headline),
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


def _sections(view: ReportView, shown: Packed, notes: Footnotes) -> list[_Section]:
    glance = table_html(view.best, notes) + _facts(view)
    return [
        _Section("overview", "At a glance", "At a glance", glance),
        _Section("tables", "Tables", "Tables, as the paper lays them out", blocks_html(view.layouts, notes)),
        _Section("time", "Error against time", "Error against run time", _time(view, notes)),
        _Section("pictures", "Pictures", "Truth, prediction, error", _pictures(shown)),
        _Section("ablations", "Ablations", "What each part is worth", _ablations(view.ablations, notes)),
        _Section("datasets", "Every score", "Every score, dataset by dataset", _every_score(view, notes)),
        _Section("runs", "Runs", "How it was made", _runs(view, notes)),
    ]


def _facts(view: ReportView) -> str:
    def lines(items: tuple[str, ...]) -> str:
        if len(items) == 1:
            return escape(items[0])
        return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"

    facts = "".join(f"<dt>{escape(term)}</dt><dd>{lines(items)}</dd>" for term, items in view.facts)
    return f'<dl class="facts">{facts}</dl>'


def _ablations(documents: tuple[Document, ...], notes: Footnotes) -> str:
    return "".join(
        f"<section><h3>{escape(document.title)} <small>{escape(document.id)}</small></h3>"
        f"{blocks_html(document.blocks, notes, 4)}</section>"
        for document in documents
    )


def _every_score(view: ReportView, notes: Footnotes) -> str:
    boards = tuple(Section(board.title, _parts(board)) for board in view.boards)
    last = tuple(part for part in (view.tested, view.claims) if part is not None)
    return blocks_html((*boards, *view.means, *last), notes)


def _parts(board: BoardView) -> tuple[Block, ...]:
    parts = (board.differences, board.asked)
    return (board.about, board.scores, *(part for part in parts if part is not None))


def _runs(view: ReportView, notes: Footnotes) -> str:
    added = blocks_html((view.added,), notes) if view.added is not None else ""
    return (
        "<details open><summary>Command, code and machine of each run</summary>"
        f"{table_html(view.runs, notes)}{items_html(view.machines)}{added}</details>"
        f"<details><summary>Where the time went</summary>{table_html(view.stages, notes)}</details>"
        f"<details><summary>{escape(view.columns.title)}</summary>{blocks_html(view.columns.blocks, notes)}</details>"
    )


def _curves(view: ReportView) -> tuple[CurveView, ...]:
    """All curves in the page's order, in which its script knows them too."""
    return (*view.mean_curves, *(curve for board in view.boards for curve in board.curves))


def _time(view: ReportView, notes: Footnotes) -> str:
    curves = _curves(view)
    if not curves:
        return ""
    tables = "".join(_curve(index, curve, notes) for index, curve in enumerate(curves))
    return f"""
<p>One line per run, with a mark at every moment that was scored; several seeds are thin lines, and their median is a
thick line in steps, because no score is interpolated. A mean over scenes begins when each of them has a score, has a
point again when each has another, and takes the last one of each. The broad grey line is the Pareto front; dotted lines
are the levels of the table below.</p>
<div class="controls">
<label>Dataset and protocol <select id="plot-board"></select></label>
<label>Score <select id="plot-score"></select></label>
<label class="tick"><input type="checkbox" id="plot-log"> score on a log axis</label>
</div>
<div class="card"><div id="chart"></div>
<ul class="legend" id="plot-legend" aria-label="Curves, which can be switched on and off"></ul></div>
<p class="caption" id="plot-note"></p>
{tables}
{paragraph_html(view.curve_rules.text, "caption")}"""


def _curve(index: int, curve: CurveView, notes: Footnotes) -> str:
    """Tables of times to reach levels and of the Pareto front; the script shows those of the selected plot."""
    no_level, no_front = (
        "No levels: no score changed while training.",
        "No Pareto front: a seed of every row failed.",
    )
    reach = table_html(curve.reach, notes) if curve.reach is not None else paragraph_html(no_level)
    front = table_html(curve.front, notes) if curve.front is not None else paragraph_html(no_front)
    return f'<div class="plot-tables" data-plot="{index}"><h4>{escape(curve.title)}</h4>{reach}{front}</div>'


def _pictures(shown: Packed) -> str:
    if not shown.data:
        return f"<p>{escape(shown.said)}</p>" if shown.said else ""
    selects = "".join(
        f'<label>{label} <select id="picture-{name}"></select></label>'
        for name, label in (
            ("board", "Dataset and protocol"),
            ("view", "Test view"),
            ("kind", "Rendered"),
            ("left", "Left of the slider"),
            ("right", "Right of the slider"),
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
    """JSON for a script element, escaped so that no tag inside can end the element."""
    return json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
