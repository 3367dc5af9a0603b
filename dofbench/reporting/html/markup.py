"""HTML by hand: escaped text, footnotes, and tables that the page's script can sort."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from dofbench.reporting.summary import Cell
from dofbench.results.columns import Column

GAP = "–"


class Notes:
    """The page's footnotes: each reason once, numbered in the order of appearance."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def mark(self, shown: str, reason: str) -> str:
        """What is shown, as a link to the footnote; the reason is on hover too."""
        reason = " ".join(reason.split())
        number = self._numbers.setdefault(reason, len(self._numbers) + 1)
        return f'<a class="why" href="#note-{number}" title="{escape(reason)}">{escape(shown)}<sup>{number}</sup></a>'

    def html(self) -> str:
        """The notes as a list; empty where there is none."""
        if not self._numbers:
            return ""
        items = "".join(f'<li id="note-{number}">{escape(reason)}</li>' for reason, number in self._numbers.items())
        return f'<ol class="notes">{items}</ol>'


@dataclass(frozen=True)
class Td:
    """One cell. sort: what it is sorted by; None sorts last, whichever way. kind: a CSS class."""

    html: str
    sort: float | str | None = None
    kind: str = ""


@dataclass(frozen=True)
class Th:
    """A heading. group: the heading above it, shared with its neighbours. note: on hover. down: whether the largest
    comes first when it is sorted first. words: whether its cells are text."""

    text: str
    group: str = ""
    note: str = ""
    down: bool = False
    words: bool = False


def text_cell(text: str) -> Td:
    """Words, sorted by themselves."""
    return Td(escape(text), text.lower(), "words")


def number_cell(value: float, shown: str, *, kind: str = "") -> Td:
    """A number, sorted by its value; a NaN last."""
    return Td(escape(shown), None if math.isnan(value) else value, f"number {kind}".strip())


def gap_cell(reason: str, notes: Notes, shown: str = GAP) -> Td:
    """No number, and why not."""
    return Td(notes.mark(shown, reason), None, "number gap" if shown == GAP else "number failure")


def score_cell(cell: Cell, column: Column, best: str | None, notes: Notes) -> Td:
    """A cell of a table of scores. best: the best of its column as it is shown."""
    if cell.value is None:
        return gap_cell(cell.reason, notes, cell.failure or GAP)
    text = column.text(cell.value)
    spread = "" if cell.spread is None else f'<span class="spread"> ± {escape(column.text(cell.spread))}</span>'
    html = f"{escape(text)}{spread}"
    if text == best:
        return Td(
            f'<strong>{html}</strong><span class="hidden">, best</span>',
            None if math.isnan(cell.value) else cell.value,
            "number best",
        )
    return Td(html, None if math.isnan(cell.value) else cell.value, "number")


def score_heading(column: Column, group: str = "") -> Th:
    """The heading of a score, with its unit, which way is better, and how it is measured."""
    return Th(column.heading, group, column.note, down=bool(column.higher_is_better))


def table(headings: Sequence[Th], rows: Sequence[Sequence[Td]], caption: str, *, left: int = 1) -> str:
    """A table in a box of its own that scrolls sideways; the first `left` cells of a row name it. A column in which
    every cell is empty is left out."""
    kept = [index for index in range(len(headings)) if not rows or any(row[index].html for row in rows)]
    headings, rows = [headings[index] for index in kept], [[row[index] for index in kept] for row in rows]
    groups = _groups(headings)
    above = ""
    if any(group for group, _ in groups):
        above = (
            "<tr>"
            + "".join(
                f'<th colspan="{count}" scope="colgroup" class="{"group" if group else "nothing"}">{escape(group)}</th>'
                if group
                else f'<td colspan="{count}" class="nothing"></td>'
                for group, count in groups
            )
            + "</tr>"
        )
    edges = _edges(groups)
    head = "".join(_heading(heading, index in edges) for index, heading in enumerate(headings))
    body = "".join(
        "<tr>" + "".join(_cell(cell, index < left, index in edges) for index, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
        f'<table class="sortable"><caption>{escape(caption)}</caption><thead>{above}<tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _groups(headings: Sequence[Th]) -> list[tuple[str, int]]:
    groups: list[tuple[str, int]] = []
    for heading in headings:
        if groups and groups[-1][0] == heading.group:
            groups[-1] = heading.group, groups[-1][1] + 1
        else:
            groups.append((heading.group, 1))
    return groups


def _edges(groups: list[tuple[str, int]]) -> set[int]:
    """Columns with which a group begins."""
    starts, at = set(), 0
    for group, count in groups:
        if group:
            starts.add(at)
        at += count
    return starts


def _heading(heading: Th, edge: bool) -> str:
    kind = " ".join(filter(None, ("words" if heading.words else "number", "edge" if edge else "")))
    note = f' title="{escape(heading.note)}"' if heading.note else ""
    first = "descending" if heading.down else "ascending"
    return (
        f'<th scope="col" class="{kind}" data-first="{first}"{note}><button type="button">{escape(heading.text)}'
        '<span class="arrow" aria-hidden="true"></span></button></th>'
    )


def _cell(cell: Td, names: bool, edge: bool) -> str:
    kind = " ".join(filter(None, (cell.kind, "edge" if edge else "")))
    sort = "" if cell.sort is None else f' data-sort="{escape(_sort_text(cell.sort))}"'
    tag, scope = ("th", ' scope="row"') if names else ("td", "")
    return f'<{tag}{scope} class="{kind}"{sort}>{cell.html}</{tag}>'


def _sort_text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return repr(float(value)).replace("inf", "Infinity")
