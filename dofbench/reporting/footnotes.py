"""Footnotes of a Markdown page: each reason once, numbered in the order of appearance."""

from __future__ import annotations


class Footnotes:
    """Collects reasons while a page is written."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def mark(self, reason: str) -> str:
        """The mark to set behind a cell; the same reason gives the same number."""
        reason = " ".join(reason.split()).replace("|", "\\|")
        return f"[^{self._numbers.setdefault(reason, len(self._numbers) + 1)}]"

    def lines(self) -> list[str]:
        """The notes, to be put at the end of the page."""
        return [f"[^{number}]: {reason}" for reason, number in self._numbers.items()]


def table(heading: list[str], rows: list[list[str]], left: int) -> list[str]:
    """A Markdown table; the first `left` columns are aligned left, the others right."""
    rule = [":---" if index < left else "---:" for index in range(len(heading))]
    return ["| " + " | ".join(cells) + " |" for cells in (heading, rule, *rows)]
