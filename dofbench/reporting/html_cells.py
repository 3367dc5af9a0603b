"""The cells of a row in HTML. Large reports have hundreds of thousands, which a template's macro is slow at."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from html import escape
from typing import Protocol
from urllib.parse import quote

from markupsafe import Markup

from dofbench.reporting.tables import Cell, DifferenceTest

_CLASSES = {"number": "number", "published": "number theirs", "gap": "number gap", "failed": "number failure"}
_SURE = ("sure", "unsure", "untested")


class Notes(Protocol):
    """Numbers the reasons of gaps, as `render.Footnotes`."""

    def number(self, reason: str) -> int: ...


def row_cells(row: Sequence[Cell], names: int, edges: Collection[int], notes: Notes) -> Markup:
    """A row's cells. names: number of leading cells that name the row. edges: columns at which a group begins."""
    return Markup("".join(_cell(one, place < names, place in edges, notes) for place, one in enumerate(row)))


def _cell(one: Cell, name: bool, edge: bool, notes: Notes) -> str:
    kind = _CLASSES.get(one.kind) or ("words long" if one.long else "words")
    best = " best" if one.best and kind == "number" else ""
    sort = f' data-sort="{escape(one.sort_text)}"' if one.sort_text else ""
    start, end = ("th scope=row", "th") if name else ("td", "td")
    inside = _gap(one, notes.number(one.reason)) if one.kind in ("gap", "failed") else _content(one, kind)
    return f'<{start} class="{kind}{best}{" edge" if edge else ""}"{sort}>{inside}</{end}>'


def _gap(one: Cell, number: int) -> str:
    reason, text = escape(" ".join(one.reason.split())), escape(one.text)
    return f'<a class="why" href="#note-{number}" title="{reason}">{text}<sup>{number}</sup></a>'


def _content(one: Cell, kind: str) -> str:
    test = one.test
    text = " ".join(f"<code>{escape(code)}</code>" for code in one.code) or escape(one.text)
    if one.link:
        text = f'<a href="{escape(quote(one.link))}/report.html">{text}</a>'
    if one.spread:
        text += f'<span class="spread"> ± {escape(one.spread)}</span>'
    if one.best:
        text = f"<strong>{text}</strong>" + ('<span class="hidden">, best</span>' if kind == "number" else "")
    if one.unit:
        text += f" {escape(one.unit)}"
    if test and test.interval:
        text += f' <span class="spread">{escape(test.interval)}</span>'
    if test and test.spread:
        text = f'<span title="± {escape(test.spread)} over {test.units} differences">{text}</span>'
    said = [escape(test.wins), escape(test.p), _verdict(test), escape(one.below)] if test else [escape(one.below)]
    if any(said):
        text += f"<br><small>{', '.join(filter(None, said))}</small>"
    return f'<span class="{one.kind}">{text}</span>' if one.kind in _SURE else text


def _verdict(test: DifferenceTest) -> str:
    shown = f"<strong>{test.verdict}</strong>" if test.verdict in ("better", "worse") else escape(test.verdict)
    return shown + (" (one seed)" if test.verdict and test.one_seed else "")
