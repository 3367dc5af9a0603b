"""Renders the templates in reports/templates. Every text is escaped unless a filter marks it up."""

from __future__ import annotations

import json
import re
from functools import cache
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from dofbench import __version__
from dofbench.core.content import content_folder
from dofbench.core.markdown_text import MARKUP, code, fenced, literal, running, visible
from dofbench.reporting.html_cells import row_cells
from dofbench.reporting.tables import one_line

# What Markdown takes for an address and a title in the definition of a link.
_ADDRESS = re.compile(r"""\S*(\s+["'(].*)?""", re.DOTALL)


class Footnotes:
    """Collects the reasons of gaps while a page is rendered; equal reasons have one number."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def number(self, reason: str) -> int:
        """The footnote number for a reason."""
        return self._numbers.setdefault(one_line(reason), len(self._numbers) + 1)

    def reasons(self) -> list[tuple[int, str]]:
        """(number, reason) of every footnote in order."""
        return [(number, reason) for reason, number in self._numbers.items()]


def markdown(name: str, **content: Any) -> str:
    """The page `name`.md. Parts are separated by empty lines."""
    text = markdown_environment().get_template(f"{name}.md.j2").render(notes=Footnotes(), **content)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def html(name: str, **content: Any) -> str:
    """The page `name`.html."""
    return html_environment().get_template(f"{name}.html.j2").render(notes=Footnotes(), version=__version__, **content)


@cache
def markdown_environment() -> Environment:
    """The environment of Markdown pages: every text is shown literally."""
    found = _environment(finalize=lambda value: value if isinstance(value, Markup) else Markup(literal(value)))
    found.filters |= {
        "code": lambda text: Markup(code(text)),
        "fenced": lambda text: Markup(fenced(text)),
        "running": lambda text: Markup(running(text)),
        "item": lambda text: Markup(running(visible(text))),
        "mark": Markup,  # of the page's own markup
        "address": lambda file: Markup(quote(file)),
        # Where a renderer has no footnotes, one word would be the address of a link.
        "note": lambda reason: Markup(("the reason is " if _ADDRESS.fullmatch(reason) else "") + literal(reason)),
    }
    return found


@cache
def html_environment() -> Environment:
    """The environment of HTML pages: every text is escaped."""
    found = _environment()
    found.filters |= {"running": _running_html, "script_data": _script_data}
    found.globals |= {"cells": row_cells}
    found.globals |= {"asset": lambda name: Markup((content_folder("reports/templates") / name).read_text("utf-8"))}
    return found


def _environment(**options: Any) -> Environment:
    loader = FileSystemLoader(content_folder("reports/templates"))
    return Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options
    )


def _running_html(text: str) -> Markup:
    """Running text escaped, with `code`, *emphasis* and **strong** as HTML."""

    def marked(found: re.Match[str]) -> str:
        tag = ("code", "strong", "em")[(found.lastindex or 1) - 1]
        return f"<{tag}>{found[found.lastindex or 1]}</{tag}>"

    return Markup(MARKUP.sub(marked, str(escape(text))))


def _script_data(data: object) -> Markup:
    """JSON for a script element, escaped so that no tag inside can end the element."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))
