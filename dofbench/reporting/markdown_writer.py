"""Writes blocks of a report as Markdown. All values come from the report's data; nothing is computed here."""

from __future__ import annotations

import re
from collections.abc import Sequence
from urllib.parse import quote

from dofbench.core.markdown_text import code, fenced, literal, running, visible
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.view import Block, Cell, Command, Document, Heading, Items, Paragraph, Picture, Section, Table

# What Markdown takes for an address and a title in the definition of a link.
_ADDRESS = re.compile(r"""\S*(\s+["'(].*)?""", re.DOTALL)


def markdown_page(document: Document) -> str:
    """The whole page, with its footnotes at the end."""
    notes = Footnotes()
    parts = [f"# {literal(document.title)}", *(part for block in document.blocks for part in _parts(block, 2, notes))]
    footnotes = [f"[^{number}]: {_note(reason)}" for number, reason in notes.reasons()]
    return "\n\n".join([*parts, *(["\n".join(footnotes)] if footnotes else [])]).rstrip() + "\n"


def _note(reason: str) -> str:
    # Where a renderer has no footnotes, one word here would be the address of a link.
    return f"the reason is {literal(reason)}" if _ADDRESS.fullmatch(reason) else literal(reason)


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """The lines of a table; the first `left` columns are aligned left, the others right."""
    rule = [":---" if index < left else "---:" for index in range(len(headings))]
    return ["| " + " | ".join(cells) + " |" for cells in (headings, rule, *rows)]


def _parts(block: Block, level: int, notes: Footnotes) -> list[str]:
    """The parts of a block that are separated by empty lines. level: heading level of the block's title."""
    match block:
        case Paragraph():
            return [running(block.text)]
        case Items():
            return ["\n".join(f"- {running(visible(item))}" for item in block.items)] if block.items else []
        case Command():
            return [fenced(block.text)]
        case Picture():
            return [f"![{literal(block.says)}]({quote(block.file)})"]
        case Table():
            return [_table(block, notes), *map(running, block.below)]
        case Section():
            inside = [part for one in block.blocks for part in _parts(one, level + 1, notes)]
            return [f"{'#' * level} {literal(block.title)}", *inside]


def _table(table: Table, notes: Footnotes) -> str:
    kept = [index for index, heading in enumerate(table.headings) if not heading.wide]
    headings = [table.headings[index] for index in kept]
    left = next((place for place, heading in enumerate(headings) if not heading.words), len(headings))
    rows = [[_cell(row[index], notes) for index in kept] for row in table.rows]
    return "\n".join(markdown_table([_heading(heading) for heading in headings], rows, left))


def _heading(heading: Heading) -> str:
    return f"*paper: {literal(heading.text)}*" if heading.published else literal(heading.text)


def _cell(cell: Cell, notes: Footnotes) -> str:
    if cell.kind in ("gap", "failed"):
        return f"{literal(cell.text)}[^{notes.number(cell.reason)}]"
    if cell.code:
        return " ".join(map(code, cell.code))
    text = literal(cell.text)
    if cell.spread:
        text += f" ± {cell.spread}"
    if cell.unit:
        text += f" {cell.unit}"
    if cell.best:
        text = f"**{text}**"
    if cell.test is not None:
        text += f" {cell.test.interval}" if cell.test.interval else ""
        text += f", {cell.test.p}" if cell.test.p else ""
        if cell.test.verdict:
            strong = "**" if cell.test.verdict in ("better", "worse") else ""
            text += f", {strong}{cell.test.verdict}{strong}" + (" (one seed)" if cell.test.one_seed else "")
    return f"{text}, {literal(cell.below)}" if cell.below else text
