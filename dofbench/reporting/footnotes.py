"""Footnotes of a page: each reason once, numbered in the order of appearance."""

from __future__ import annotations


class Footnotes:
    """Collects reasons while a page is written."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def number(self, reason: str) -> int:
        """The number to set behind a cell; the same reason has the same number."""
        return self._numbers.setdefault(one_line(reason), len(self._numbers) + 1)

    def reasons(self) -> tuple[tuple[int, str], ...]:
        """(number, reason) of every note, to be put at the end of the page."""
        return tuple((number, reason) for reason, number in self._numbers.items())


def one_line(text: str) -> str:
    """Without line breaks, which no cell and no note can hold."""
    return " ".join(text.split())
