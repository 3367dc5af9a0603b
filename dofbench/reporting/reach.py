"""Training time to reach a score: the levels, the first moment at which a run reaches one, and median and range over
seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.core.errors import InputError, Status
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.reporting.series import Point, Run, Series

RULE = (
    "A score counts as reached at the first scored moment that shows it; nothing is interpolated between two moments. "
    "So a time is an upper bound: the true one lies after the moment scored before, which stands in reach.csv. Over "
    "seeds it is the median and the range; a run that failed, or never showed the score, counts as later than every "
    "other."
)
LEVEL_RULE = (
    "The levels are half, four fifths and 95 % of the way from the worst first score of any run to the best that "
    "any method shows (median over its seeds), each rounded to the easier side"
)
_SHARES = (0.5, 0.8, 0.95)
_STEPS_A_WAY = 20  # a level is rounded to a step of 1, 2 or 5 times a power of ten, of at most 1 / this of the way


@dataclass(frozen=True)
class Reached:
    """One run. time: training seconds at the first scored moment at the level or better; None when there is none.
    before: the moment that was scored before that one, 0 if there is none. held: whether the last score still reaches
    the level."""

    time: float | None
    before: float = 0.0
    held: bool = False


@dataclass(frozen=True)
class ReachCell:
    """Times over the seeds of a series. median, low, high: infinite if the level wasn't reached. count: number of seeds
    that reached it. lost: how many of these have a worse score at the end."""

    median: float
    low: float
    high: float
    seeds: int
    count: int
    lost: int

    @property
    def text(self) -> str:
        """A text such as "42.1 s (40.0 to 45.2)", "42.1 s (40.0 to not reached)" or "not reached"."""
        if not math.isfinite(self.median):
            return "not reached" + (f" ({self.count} of {self.seeds} seeds did)" if self.count else "")
        text = seconds_text(self.median)
        if self.seeds > 1:
            high = seconds_text(self.high) if math.isfinite(self.high) else "not reached"
            text += f" ({seconds_text(self.low)} to {high})"
        if self.lost:
            text += ", lost again" + (f" by {self.lost} of {self.seeds}" if self.seeds > 1 else "")
        return text


def reached(points: Sequence[Point], level: float, *, higher_is_better: bool) -> Reached:
    """The first moment at which a curve reaches the level."""
    before = 0.0
    for time, score in points:
        if at_least(score, level, higher_is_better):
            return Reached(time, before, at_least(points[-1][1], level, higher_is_better))
        before = time
    return Reached(None)


def run_reached(run: Run, level: float, *, higher_is_better: bool) -> Reached:
    """`reached` for a run; a run that failed has no model, so it reaches no level."""
    if run.status is not Status.OK:
        return Reached(None)
    return reached(run.points, level, higher_is_better=higher_is_better)


def reach_cell(series: Series, level: float, *, higher_is_better: bool) -> ReachCell:
    """Median and range over the seeds."""
    found = [run_reached(run, level, higher_is_better=higher_is_better) for run in series.runs]
    times = [math.inf if one.time is None else one.time for one in found]
    return ReachCell(
        median=statistics.median(times),
        low=min(times),
        high=max(times),
        seeds=len(times),
        count=sum(one.time is not None for one in found),
        lost=sum(one.time is not None and not one.held for one in found),
    )


def levels(series: Sequence[Series], *, higher_is_better: bool) -> tuple[float, ...]:
    """Levels chosen by `LEVEL_RULE`; none if no run improves its score."""
    firsts = [run.points[0][1] for one in series for run in one.runs if run.points]
    shown = [score for one in series for _, score in one.median]
    if not firsts or not shown:
        return ()
    worst, best = (min(firsts), max(shown)) if higher_is_better else (max(firsts), min(shown))
    way = best - worst
    if way == 0 or (way > 0) is not higher_is_better:
        return ()
    step = round_step(abs(way) / _STEPS_A_WAY)
    easier = math.floor if higher_is_better else math.ceil
    # The number of steps is rounded to six decimals before floor or ceil, so that 0.3 / 0.1 counts as 3.
    found = [easier(round((worst + share * way) / step, 6)) * step for share in _SHARES]
    digits = max(0, -math.floor(math.log10(step)))
    return tuple(dict.fromkeys(round(level, digits) for level in found))


def round_step(largest: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that isn't above `largest`, which is positive."""
    power = 10.0 ** math.floor(math.log10(largest))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= largest * (1 + 1e-9) or factor == 1.0)


def at_least(score: float, level: float, higher_is_better: bool) -> bool:
    """Whether a score is at least as good as the level; False for NaN."""
    return score >= level if higher_is_better else score <= level


def level_text(column: str, level: float) -> str:
    """A text such as "PSNR ≥ 30 dB" or "δ_F ≤ 0.01"."""
    known = COLUMNS[column]
    unit = f" {known.unit}" if known.unit else ""
    return f"{known.label} {'≥' if known.higher_is_better else '≤'} {level:g}{unit}"


def seconds_text(seconds: float) -> str:
    """Seconds with three significant digits, and at most one decimal."""
    digits = 0 if seconds >= 100 else 1 if seconds >= 1 else 2
    return f"{seconds:.{digits}f} s"


def parse_levels(text: str) -> dict[str, tuple[float, ...]]:
    """Column -> levels, of `--reach psnr=28,psnr=30,delta_f=0.01`. Raises InputError."""
    found: dict[str, tuple[float, ...]] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        column, equals, value = part.partition("=")
        known = [name for name, one in COLUMNS.items() if one.higher_is_better is not None]
        if not equals or column not in known:
            raise InputError("--reach", repr(part), f"SCORE=LEVEL with a score of {', '.join(known)}")
        try:
            level = float(value)
        except ValueError:
            level = math.nan
        if not math.isfinite(level):
            raise InputError("--reach", repr(part), f"a number for {column}")
        found[column] = (*found.get(column, ()), level)
    return found
