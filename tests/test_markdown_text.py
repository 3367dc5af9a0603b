"""Text of strangers in Markdown: a renderer that lets HTML through makes nothing of it but text."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from dofbench.core.markdown_text import block, code, literal, running, visible
from dofbench.reporting.render import markdown
from dofbench.reporting.tables import Cell, Heading, Section, Table

RENDERER = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
ATTACKS = (
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "a <!-- b",
    "</table></p><svg/onload=alert(1)>",
    "[x](javascript:alert(1))",
    "![x](http://evil/pixel.png)",
    "[x]: javascript:alert(1)",
    "[a [b] c](javascript:alert(1))",
    "<javascript:alert(1)>",
    "<https://evil>",
    "&lt;script&gt; &#60;b>",
    "# heading",
    "1. one",
    "- item",
    "> quote",
    "a\n\n<b>b</b>\n===",
    "---",
    "`code`` ` <b>",
    "``` <b>\n<i>",
    "a | b | c",
    "**bold** _em_ ~~gone~~ *em*",
    "\\",
    "\\<b>",
    "\\\\[x](y)",
    "trailing <",
    "x\x1b[31m\u202e\ud800",
    "    indented",
)
TEXTS = st.one_of(
    st.sampled_from(ATTACKS),
    st.text(alphabet="<>/ab=\"'`*_[]()!|\\&#;:-+~.1 \n\t^", max_size=30),
    st.lists(st.sampled_from(ATTACKS), min_size=2, max_size=3).map("".join),
)


class _Seen(HTMLParser):
    """Elements and attributes of a page, and its text."""

    def __init__(self, markdown: str):
        super().__init__(convert_charrefs=True)
        self.elements: list[str] = []
        self.text = ""
        self.feed(RENDERER.render(markdown))
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(" ".join([tag, *(name for name, _ in attrs if name != "style")]))

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_comment(self, data: str) -> None:
        self.elements.append("comment")


@given(TEXTS)
@example("a\\")
@example("x<")
def test_literal_text_is_shown_as_it_is(text: str) -> None:
    shown = visible(text)
    for page, elements, before in (
        (literal(text), ["p"] if shown else [], ""),
        (f"# x {literal(text)}", ["h1"], "x "),
        (f"a {literal(text)}\n{literal(text)}.", ["p"], "a "),
        (f"- {literal(text)}", ["ul", "li"], "\n"),
    ):
        seen = _Seen(page)
        assert seen.elements == elements
        assert seen.text.strip().startswith((before + shown).strip())


@given(TEXTS)
def test_code_is_shown_as_it_is(text: str) -> None:
    seen = _Seen(f"a {code(text)} b")
    assert seen.elements == ["p", "code"] and visible(text).replace("|", "\\|") in seen.text
    seen = _Seen(f"a\n\n{block(text or 'x')}\n\nb")
    assert [tag for tag in seen.elements if tag != "p"] == (["pre", "code"] if visible(text or "x") else [])


@given(TEXTS, TEXTS)
@example("<script>alert(1)</script>![x](http://evil/pixel.png)", "[")
@example("x", "< >")
def test_a_page_has_no_elements_but_its_own(text: str, other: str) -> None:
    def page(text: str, other: str) -> list[str]:
        table = Table(
            text,
            (Heading(text), Heading(other, published=True)),
            (
                (Cell(text), Cell("", code=(text, other))),
                (Cell(text, "gap", reason=other), Cell(other, below=text)),
                (Cell("a"), Cell("a")),
            ),
        )
        items = (visible(text).replace("*", "").replace("`", ""),)
        inside = Section(text, command=f"a {other}", items=items, sections=(Section(text, tables=(table,)),))
        return _Seen(markdown("ablation", page=inside)).elements

    assert page(text, other) == page("x" if visible(text) else "", "y" if visible(other) else "")


@example("* *")
@given(TEXTS)
def test_running_text_has_its_own_markup_and_nothing_else(text: str) -> None:
    assert set(_Seen(running(text)).elements) <= {"p", "code", "em", "strong"}
    assert _Seen(running("a `b` **c** *d* <e>")).elements == ["p", "code", "strong", "em"]


@pytest.mark.parametrize(
    "text",
    [
        "fern_small",
        "deblur-nerf-real/seal",
        "-0.12",
        "[+0.12, +0.50]",
        "f/2.8, 30 mm",
        "CC BY 4.0",
        "a & b",
        "x < 3",
        "é",
    ],
)
def test_ordinary_text_stays_as_it_is(text: str) -> None:
    assert literal(text) == text and running(f"{text}, and\nso on") == f"{text}, and\nso on"
