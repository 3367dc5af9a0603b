"""The content of a Markdown page: links, headings, code blocks with their marks, command lines."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(r"^(?:<!-- (?P<mark>.*?) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    .*\n?)+", re.MULTILINE)
_LINK = re.compile(r"\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """A fenced block. mark: of the comment in the line above it: `run`, `file: PATH`, `in: PATH after: LINE`, or ""."""

    mark: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    return [Block(found["mark"] or "", found["language"], found["text"]) for found in _FENCE.finditer(page.read_text())]


def prose(page: Path) -> str:
    """The page without fenced blocks, and without code within a line."""
    return re.sub(r"`[^`\n]*`", "`code`", _FENCE.sub("", page.read_text()))


def links(page: Path) -> list[str]:
    """Targets of the page's links, as they stand there."""
    return _LINK.findall(prose(page))


def anchors(page: Path) -> set[str]:
    """What a link into the page may name: its headings, in lower case, with hyphens, as GitHub makes them."""
    text = _FENCE.sub("", page.read_text())
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in plain}


def commands(page: Path) -> Iterator[list[str]]:
    """Every call of `dofbench` in the page's blocks, as words without the program; a comment behind it is none."""
    shell = [block.text for block in blocks(page) if block.language in ("sh", "")]
    rest = _FENCE.sub("", page.read_text())
    for text in (*shell, *_INDENTED.findall(rest)):
        for line in text.replace("\\\n", " ").splitlines():
            for call in line.split("&&"):
                try:
                    words = shlex.split(call, comments=True)
                except ValueError:  # not a shell command, for example a formula
                    continue
                if words and words[0].removeprefix(".venv/bin/") == "dofbench":
                    yield words[1:]
