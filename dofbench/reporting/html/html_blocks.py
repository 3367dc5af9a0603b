"""Writes blocks of a report as HTML: escaped text, footnotes, and tables that the page's script can sort. All values
come from the report's data; nothing is computed here."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape

from dofbench.core.markdown_text import MARKUP
from dofbench.reporting.footnotes import Footnotes, one_line
from dofbench.reporting.view import (
    Block,
    Cell,
    Command,
    DifferenceTest,
    Heading,
    Items,
    Paragraph,
    Picture,
    Section,
    Table,
)

_CLASSES = {"number": "number", "published": "number theirs", "gap": "number gap", "failed": "number failure"}
_LONG = 40  # characters: a column of words at least this long gets a minimum width


def notes_html(notes: Footnotes) -> str:
    """The footnotes as a list; empty without footnotes."""
    items = "".join(f'<li id="note-{number}">{escape(reason)}</li>' for number, reason in notes.reasons())
    return f'<ol class="notes">{items}</ol>' if items else ""


def blocks_html(blocks: Sequence[Block], notes: Footnotes, level: int = 3) -> str:
    """The blocks in order. level: heading level of sections among them."""
    return "".join(_block(block, notes, level) for block in blocks)


def paragraph_html(text: str, kind: str = "") -> str:
    """Running text with the markup that `dofbench.reporting.view` describes. kind: a CSS class."""
    return f'<p class="{kind}">{_inline(text)}</p>' if kind else f"<p>{_inline(text)}</p>"


def items_html(items: Items) -> str:
    """A list."""
    return "<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items.items) + "</ul>" if items.items else ""


def table_html(table: Table, notes: Footnotes) -> str:
    """A table in a box of its own that scrolls sideways, and the lines below it. A column in which every cell is empty
    is left out."""
    kept = [
        index
        for index in range(len(table.headings))
        if not table.rows or any(row[index].text or row[index].code for row in table.rows)
    ]
    headings = [table.headings[index] for index in kept]
    groups = _groups(headings)
    edges = _edges(groups)
    head = "".join(_heading(heading, index in edges) for index, heading in enumerate(headings))
    body = "".join(
        "<tr>"
        + "".join(_cell(row[index], place < table.names, place in edges, notes) for place, index in enumerate(kept))
        + "</tr>"
        for row in table.rows
    )
    below = "".join(paragraph_html(line, "left-out") for line in table.below)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.caption)}">'
        f'<table class="sortable"><caption>{escape(table.caption)}</caption>'
        f"<thead>{_group_row(groups)}<tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{below}"
    )


def _block(block: Block, notes: Footnotes, level: int) -> str:
    match block:
        case Paragraph():
            return paragraph_html(block.text)
        case Items():
            return items_html(block)
        case Command():
            return f"<pre><code>{escape(block.text)}</code></pre>"
        case Picture():
            return f'<p><a href="{escape(block.file)}">{escape(block.says)}</a></p>'
        case Table():
            return table_html(block, notes)
        case Section():
            inside = blocks_html(block.blocks, notes, level + 1)
            return f"<section><h{level}>{escape(block.title)}</h{level}>{inside}</section>"


def _inline(text: str) -> str:
    """The text escaped, with `code`, *emphasis* and **strong** as HTML."""

    def marked(found: re.Match[str]) -> str:
        for tag, inside in zip(("code", "strong", "em"), found.groups(), strict=True):
            if inside is not None:
                return f"<{tag}>{inside}</{tag}>"
        return found[0]

    return MARKUP.sub(marked, escape(text))


def _groups(headings: Sequence[Heading]) -> list[tuple[str, int]]:
    groups: list[tuple[str, int]] = []
    for heading in headings:
        if groups and groups[-1][0] == heading.group:
            groups[-1] = heading.group, groups[-1][1] + 1
        else:
            groups.append((heading.group, 1))
    return groups


def _group_row(groups: list[tuple[str, int]]) -> str:
    if not any(group for group, _ in groups):
        return ""
    cells = "".join(
        f'<th colspan="{count}" scope="colgroup" class="group">{escape(group)}</th>'
        if group
        else f'<td colspan="{count}" class="nothing"></td>'
        for group, count in groups
    )
    return f"<tr>{cells}</tr>"


def _edges(groups: list[tuple[str, int]]) -> set[int]:
    """The columns at which a group begins."""
    starts, at = set(), 0
    for group, count in groups:
        if group:
            starts.add(at)
        at += count
    return starts


def _heading(heading: Heading, edge: bool) -> str:
    kind = " ".join(filter(None, ("words" if heading.words else "number", "edge" if edge else "")))
    note = f' title="{escape(heading.note)}"' if heading.note else ""
    first = "descending" if heading.largest_first else "ascending"
    return (
        f'<th scope="col" class="{kind}" data-first="{first}"{note}><button type="button">{escape(heading.text)}'
        '<span class="arrow" aria-hidden="true"></span></button></th>'
    )


def _cell(cell: Cell, names: bool, edge: bool, notes: Footnotes) -> str:
    kind = _CLASSES.get(cell.kind, "words")
    if kind == "words" and any(len(text) > _LONG for text in (cell.text, *cell.code)):
        kind += " long"
    if kind == "number" and cell.best:
        kind += " best"
    kind += " edge" if edge else ""
    sort = "" if cell.sort is None else f' data-sort="{escape(_sort_text(cell.sort))}"'
    tag, scope = ("th", ' scope="row"') if names else ("td", "")
    return f'<{tag}{scope} class="{kind}"{sort}>{_content(cell, notes)}</{tag}>'


def _content(cell: Cell, notes: Footnotes) -> str:
    if cell.kind in ("gap", "failed"):
        return _footnoted(cell, notes)
    html = " ".join(f"<code>{escape(code)}</code>" for code in cell.code) if cell.code else escape(cell.text)
    if cell.spread:
        html += f'<span class="spread"> ± {escape(cell.spread)}</span>'
    if cell.best:
        html = f"<strong>{html}</strong>" + ('<span class="hidden">, best</span>' if cell.kind == "number" else "")
    if cell.unit:
        html += f" {escape(cell.unit)}"
    small = []
    if cell.test is not None:
        if cell.test.interval:
            html += f' <span class="spread">{escape(cell.test.interval)}</span>'
        if cell.test.spread:  # spread of the single differences; the interval is that of their mean
            html = f'<span title="± {escape(cell.test.spread)} over {cell.test.pairs} pairs">{html}</span>'
        small += [escape(cell.test.p)] if cell.test.p else []
        small += [_verdict(cell.test)] if cell.test.verdict else []
    small += [escape(cell.below)] if cell.below else []
    if small:
        html += f"<br><small>{', '.join(small)}</small>"
    return f'<span class="{cell.kind}">{html}</span>' if cell.kind in ("sure", "unsure", "untested") else html


def _verdict(test: DifferenceTest) -> str:
    strong = test.verdict in ("better", "worse")
    word = f"<strong>{escape(test.verdict)}</strong>" if strong else escape(test.verdict)
    return word + (" (one seed)" if test.one_seed else "")


def _footnoted(cell: Cell, notes: Footnotes) -> str:
    """The cell's text as a link to its footnote; the reason also appears on hover."""
    number, reason = notes.number(cell.reason), escape(one_line(cell.reason))
    return f'<a class="why" href="#note-{number}" title="{reason}">{escape(cell.text)}<sup>{number}</sup></a>'


def _sort_text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return repr(float(value)).replace("inf", "Infinity")
