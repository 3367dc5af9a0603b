"""Text from files and users in Markdown that we write: shown as it is, whatever a renderer makes of Markdown and HTML.

A dataset's name, a licence or a method in a result may be a stranger's, and a page is rendered where its reader is
logged in. Ordinary names, numbers and sentences come out unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

# What begins a block, or underlines a heading, where it is first in a line.
_BLOCK = re.compile(r"^(?=(?:#{1,6}|[-+]+|=+)(?:\s|$)|>)")
_NUMBERED = re.compile(r"^(\d{1,9})(?=[.)](?:\s|$))")
# A backslash that would escape something; what marks code, emphasis, struck text and cells; an underscore beside a
# word, not within one; a tag; an entity; what ends a link's text, which another text on the page may have begun.
_INLINE = re.compile(r"\\(?=[!-/:-@\[-`{-~]|$)|[`*~|]|(?<!\w)_|_(?!\w)|<(?=[A-Za-z/!?]|$)|^<|&(?=#?\w+;)|\](?=[(\[:])")
_ENTITIES = {"<": "&lt;", "&": "&amp;"}
# A bracket can begin a link, a definition or a footnote only where one of these is in the line.
_LINKS = ("](", "][", "]:", "[^")
# The markup of a report's running text (dofbench/reporting/tables.py). A star beside a space marks no emphasis, as in
# Markdown, where it may begin a list.
MARKUP = re.compile(r"`([^`]+)`|\*\*(?!\s)([^*]+)(?<!\s)\*\*|\*(?!\s)([^*]+)(?<!\s)\*")


def visible(text: str) -> str:
    """One line, without control characters, which some programs obey, and without halves of surrogate pairs."""
    line = " ".join(text.split())
    if line.isprintable():
        return line
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in line)


def literal(text: object) -> str:
    """`text` in one line as literal text: no element, no link and no table cell begins or ends in it. It may stand
    anywhere in a paragraph, a heading, an item or a cell."""
    line = visible(str(text))
    return _first(_escaped(line, line))


def code(text: object) -> str:
    """`text` in one line as a code span, in a table cell too."""
    line = visible(str(text)).replace("|", "\\|")
    longest = max((len(run) for run in re.findall("`+", line)), default=0)
    fence = "`" * (longest + 1)
    pad = " " if line.startswith("`") or line.endswith("`") or not line else ""
    return f"{fence}{pad}{line}{pad}{fence}"


def block(text: object) -> str:
    """`text` in one line as a block of code below a paragraph or heading; below a list it would be a part of that."""
    return f"    {visible(str(text))}"


def fenced(text: object) -> str:
    """`text` in one line as a block of code, below anything."""
    line = visible(str(text))
    fence = "`" * max([3, *(len(run) + 1 for run in re.findall("`+", line))])
    return f"{fence}\n{line}\n{fence}"


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """The lines of a table of escaped cells; the first `left` columns are aligned left, the others right."""
    rule = [":---" if index < left else "---:" for index in range(len(headings))]
    return ["| " + " | ".join(cells) + " |" for cells in (headings, rule, *rows)]


def running(text: str) -> str:
    """A report's running text, of several lines perhaps: its own markup is kept, all else is literal."""
    return "\n".join(_running_line(visible(line)) for line in text.split("\n"))


def _running_line(line: str) -> str:
    parts, end = [], 0
    for found in MARKUP.finditer(line):
        parts.append(_escaped(line[end : found.start()], line))
        for inside, mark in zip(found.groups()[1:], ("**", "*"), strict=True):
            if inside is not None:
                parts.append(f"{mark}{_escaped(inside, line)}{mark}")
        if found[1] is not None:
            parts.append(code(found[1]))
        end = found.end()
    return _first("".join([*parts, _escaped(line[end:], line)]))


def _escaped(part: str, line: str) -> str:
    """A part of a line escaped, but for what only matters at the line's beginning."""
    escaped = _INLINE.sub(lambda found: _ENTITIES.get(found[0], f"\\{found[0]}"), part)
    return escaped.replace("[", "\\[") if any(mark in line for mark in _LINKS) else escaped


def _first(line: str) -> str:
    line = _NUMBERED.sub(r"\1\\", line)
    return f"\\{line}" if _BLOCK.search(line) else line
