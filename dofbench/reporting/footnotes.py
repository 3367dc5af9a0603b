"""Footnotes of a page: each reason appears once, and they are numbered in order of appearance."""

from __future__ import annotations


class Footnotes:
    """Collects reasons while a page is written."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def number(self, reason: str) -> int:
        """The footnote number for a reason; equal reasons have one number."""
        return self._numbers.setdefault(one_line(reason), len(self._numbers) + 1)

    def reasons(self) -> tuple[tuple[int, str], ...]:
        """(number, reason) of every note, to be put at the end of the page."""
        return tuple((number, reason) for reason, number in self._numbers.items())


def one_line(text: str) -> str:
    """The text without line breaks, which cells and footnotes can't contain."""
    return " ".join(text.split())
