"""Cells and headings of tables, for scores, gaps, differences and published figures."""

from __future__ import annotations

import math

from dofbench.evaluation.results.columns import COLUMNS, Column
from dofbench.reporting.differences import Compared
from dofbench.reporting.summary import Statistic
from dofbench.reporting.view import GAP, Cell, DifferenceTest, Heading

_PUBLISHED_DIGITS = 3  # decimals of a printed SSIM


def words(text: str, signs: str = "") -> Cell:
    """A cell of text, sorted by the text. signs: shown behind it (`dofbench.reporting.standing`)."""
    return Cell(signed(text, signs), sort=text.lower())


def signed(text: str, signs: str) -> str:
    """The text with signs behind it."""
    return f"{text} {signs}" if signs else text


def number(value: float, text: str) -> Cell:
    """A number shown as `text` and sorted by its value; NaN sorts last."""
    return Cell(text, "number", None if math.isnan(value) else value)


def gap(reason: str) -> Cell:
    """A cell without a number, with the reason."""
    return Cell(GAP, "gap", reason=reason)


def score(found: Statistic, column: Column, best: str | None = None) -> Cell:
    """A score with its spread. best: the best value of its column, in rounded form."""
    if found.value is None:
        return Cell(found.failure, "failed", reason=found.reason) if found.failure else gap(found.reason)
    text = column.text(found.value)
    spread = "" if found.spread is None else column.text(found.spread)
    sort = None if math.isnan(found.value) else found.value
    return Cell(text, "number", sort, spread, best=text == best)


def published(value: float | None, column: Column, silent: str) -> Cell:
    """A figure that authors published, with as many digits as published; for None, a gap with the reason `silent`."""
    if value is None:
        return gap(silent)
    return Cell(f"{value:.{min(column.digits, _PUBLISHED_DIGITS)}f}", "published", value)


def difference(compared: Compared) -> Cell:
    """A difference with its interval, its p and its verdict; a gap if there is no difference.

    A difference that is zero at the column's digits has no verdict here, whatever the test says.
    """
    found, column = compared.difference, COLUMNS[compared.column]
    if found is None:
        return gap(compared.reason)

    def signed(value: float) -> str:
        return f"{value:+.{column.digits}f}"

    text = signed(found.mean)
    interval = "" if found.low is None or found.high is None else f"[{signed(found.low)}, {signed(found.high)}]"
    tested = DifferenceTest(
        interval=interval,
        p="" if found.p is None else "p < 0.001" if found.p < 0.001 else f"p = {found.p:.3f}",
        verdict="" if float(text) == 0 else compared.verdict,
        one_seed=found.seeds < 2,
        pairs=found.pairs,
        spread="" if found.spread is None else column.text(found.spread),
    )
    return Cell(text, "number", None if math.isnan(found.mean) else found.mean, test=tested)


def score_heading(column: Column, group: str = "", *, published: bool = False) -> Heading:
    """The heading of a score, with its unit, whether higher or lower is better, and how it is measured."""
    return Heading(column.heading, group, column.note, bool(column.higher_is_better), published=published)


def word_headings(*texts: str) -> tuple[Heading, ...]:
    """Headings of columns of text."""
    return tuple(Heading(text, words=True) for text in texts)
