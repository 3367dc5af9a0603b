"""Score against training time as plain data: curves, medians over seeds, means over scenes, the Pareto front, and the
time to reach a score."""

from __future__ import annotations

import bisect
import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

from dofbench.core.errors import InputError, Status
from dofbench.core.evidence import ROLE_NOT_STATED, ROLE_WORDS, Role
from dofbench.evaluation.figures import LOOKS
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS, Column
from dofbench.reporting.boards import Board, Names, Variant, by_kind, mean_names, united

_SHARES = (0.5, 0.8, 0.95)  # of the way from the worst first score to the best: the levels to reach
_STEPS_A_WAY = 20  # a level is rounded to a step of 1, 2 or 5 times a power of ten, of at most 1 / this of the way

Point = tuple[float, float]  # (training seconds, score)
Levels = Mapping[str, tuple[float, ...]]  # score -> levels that the user asked for


@dataclass(frozen=True)
class Curve:
    """One seed; seed None for a mean over scenes. points: scored moments with a finite score, by time. dropped: number
    of moments without one."""

    seed: int | None
    status: Status
    points: tuple[Point, ...]
    dropped: int


@dataclass(frozen=True)
class Series:
    """The seeds of one variant. median: curve over its seeds, empty if a seed failed or has no point. place: its number
    among the report's variants, which decides its look in every plot. signs: as of `boards.NOTES`."""

    variant: Variant
    method: str
    preset: str
    runs: tuple[Curve, ...]
    median: tuple[Point, ...]
    place: int
    signs: str = ""

    @property
    def name(self) -> str:
        """Method and preset."""
        return f"{self.method} {self.preset}".strip()

    @property
    def label(self) -> str:
        """Method and preset with the signs."""
        return f"{self.name} {self.signs}".strip()

    def rank(self, *, higher_is_better: bool) -> tuple[bool, float]:
        """Sort key: best last score first, series with a failed seed last."""
        last = statistics.median(run.points[-1][1] for run in self.runs if run.points)
        return not self.median, -last if higher_is_better else last

    @property
    def failures(self) -> str:
        """How runs of this variant failed; empty if none did."""
        return ", ".join(sorted({str(run.status) for run in self.runs if run.status is not Status.OK}))


class FrontPoint(NamedTuple):
    """A scored moment on the Pareto front: no other is as early and as good, and earlier or better. series: index."""

    time: float
    score: float
    series: int


@dataclass(frozen=True)
class Plot:
    """The plot of one score on one board, or of its mean over several. scene: "" for a mean. series: best last score
    first. levels: scores to reach; chosen: whether the user chose them. nothing: score of a lens predictor that learns
    nothing. in_files: the dataset in files where its name differs."""

    board: tuple[str, ...]
    dataset: str
    scene: str
    role: Role | None
    column: str
    series: tuple[Series, ...]
    front: tuple[FrontPoint, ...]
    levels: tuple[float, ...]
    chosen: bool
    nothing: float | None
    in_files: str = ""

    @property
    def protocol(self) -> str:
        """The protocol under which the board's runs were scored."""
        return self.board[2]

    @property
    def title(self) -> str:
        """Name and protocol, and the role of the scene (a mean has it in its name)."""
        return ", ".join(filter(None, (self.dataset, self.protocol, ROLE_WORDS[self.role] if self.scene else "")))

    @property
    def identity(self) -> dict[str, object]:
        """What rows of CSV files say of it."""
        role = self.role or ROLE_NOT_STATED
        return {"dataset": self.in_files or self.dataset, "protocol": self.protocol, "score": self.column, "role": role}

    @property
    def score(self) -> Column:
        """The column that is plotted."""
        return COLUMNS[self.column]

    @property
    def higher_is_better(self) -> bool:
        """Whether higher scores are better."""
        return bool(self.score.higher_is_better)


# ---- series ----


def board_plots(boards: Sequence[Board], names: Names, wanted: Levels) -> list[Plot]:
    """The plots of every board, for the scores that its curves have. names: of all variants of the report. wanted:
    levels that replace automatic ones."""
    plots = []
    for board in boards:
        nothing = next((one.result.do_nothing for one in board.members if one.result and one.result.do_nothing), {})
        scored = {
            column for one in board.members if one.result for point in one.result.curve for column in point.scores
        }
        for column in (column for column in COLUMNS if column in scored):
            if series := _series(board, column, names):
                where = board.key, board.name, board.scene, board.role
                plots.append(_plot(*where, column, series, nothing.get(column), wanted))
    return plots


def mean_plots(boards: Sequence[Board], plots: Sequence[Plot], wanted: Levels) -> list[Plot]:
    """The plots of the means over the boards of each kind that has several, for scores that all of them have."""
    means = []
    for kind, scenes in by_kind(boards).items():
        name, in_files = mean_names(kind, scenes)
        where = ("means", kind, scenes[0].protocol), name, "", scenes[0].role
        keys = {board.key for board in scenes}
        for column in COLUMNS if len(scenes) > 1 else ():
            own = [plot for plot in plots if plot.column == column and plot.board in keys]
            if len(own) == len(scenes) and (series := mean_series([plot.series for plot in own])):
                known = [plot.nothing for plot in own if plot.nothing is not None]
                nothing = statistics.fmean(known) if len(known) == len(own) else None
                means.append(replace(_plot(*where, column, series, nothing, wanted), in_files=in_files))
    return means


def _plot(
    board: tuple[str, ...],
    dataset: str,
    scene: str,
    role: Role | None,
    column: str,
    series: Sequence[Series],
    nothing: float | None,
    wanted: Levels,
) -> Plot:
    higher = bool(COLUMNS[column].higher_is_better)
    series = tuple(sorted(series, key=lambda one: one.rank(higher_is_better=higher)))
    front = pareto_front([one.median for one in series], higher_is_better=higher)
    reach = wanted.get(column) or levels(series, higher_is_better=higher)
    return Plot(board, dataset, scene, role, column, series, front, reach, column in wanted, nothing)


def _series(board: Board, column: str, names: Names) -> list[Series]:
    """The series of one board that have a point."""
    found = []
    # With more variants than looks two lines of one plot could look alike, if places were the report's.
    places = list(names if len(names) <= LOOKS else board.variants)
    for variant, seeds in board.variants.items():
        runs = tuple(curve_of(entry, column) for entry in seeds)
        if any(run.points for run in runs):
            whole = all(run.points and run.status is Status.OK for run in runs)
            median = joint_curve([run.points for run in runs], statistics.median) if whole else ()
            signs = board.lines[variant].signs
            found.append(Series(variant, *names[variant], runs, median, places.index(variant), signs))
    return found


def curve_of(entry: Entry, column: str) -> Curve:
    """One run's curve of one score."""
    scored = [
        (point.train_s, point.scores[column])
        for point in (entry.result.curve if entry.result else ())
        if column in point.scores and point.train_s > 0
    ]
    points = tuple(point for point in scored if math.isfinite(point[1]))
    return Curve(entry.spec.seed, entry.status, points, len(scored) - len(points))


def mean_series(scenes: Sequence[Sequence[Series]]) -> list[Series]:
    """Means over scenes, of the variants that have a median over seeds on each. scenes: the series of each."""
    own = [{series.variant: series for series in found if series.median} for found in scenes]
    means = []
    for variant, first in own[0].items():
        if all(variant in one for one in own):
            every = [one[variant] for one in own]
            curve = joint_curve([series.median for series in every], statistics.fmean)
            signs = united(series.signs for series in every)
            run = Curve(None, Status.OK, curve, 0)
            means.append(Series(variant, first.method, first.preset, (run,), curve, first.place, signs))
    return means


def joint_curve(curves: Sequence[Sequence[Point]], together: Callable[[Sequence[float]], float]) -> tuple[Point, ...]:
    """One curve of several, without interpolation: a point when each of them has been scored, again when each has
    another score, and at the end. So moments milliseconds apart are one point and not a stair.

    together: makes one score of the last measured ones. Raises ValueError for a curve without a point.
    """
    if not curves or not all(curves):
        raise ValueError("joint curve: expected at least one point of each, found none")
    if len(curves) == 1:
        return tuple(curves[0])
    moments = [[time for time, _ in curve] for curve in curves]
    times = sorted({time for own in moments for time in own})
    points: list[Point] = []
    shown = [0] * len(curves)  # how many scores of each the last point took in
    for time in times:
        scored = [bisect.bisect_right(own, time) for own in moments]
        if time == times[-1] or all(now > before for now, before in zip(scored, shown, strict=True)):
            points.append((time, together([curve[count - 1][1] for curve, count in zip(curves, scored, strict=True)])))
            shown = scored
    return tuple(points)


# ---- Pareto front ----


def pareto_front(curves: Sequence[Sequence[Point]], *, higher_is_better: bool) -> tuple[FrontPoint, ...]:
    """The front over all points of all curves, by time; of points with equal time and score all are on the front."""
    sign = 1.0 if higher_is_better else -1.0
    points = sorted((time, -sign * score, index) for index, curve in enumerate(curves) for time, score in set(curve))
    front: list[FrontPoint] = []
    best = math.inf
    for time, group in groupby(points, key=lambda point: point[0]):
        at_once = list(group)
        least = at_once[0][1]
        if least < best:
            best = least
            front += [FrontPoint(time, -sign * cost, index) for _, cost, index in at_once if cost == least]
    return tuple(front)


def spans(front: Sequence[FrontPoint]) -> Iterator[tuple[int, Point, Point]]:
    """The front as stretches of one series each, by time: (index of the series, first point, last point)."""
    for series, group in groupby(front, key=lambda point: point.series):
        points = [(time, score) for time, score, _ in group]
        yield series, points[0], points[-1]


# ---- time to reach a score ----


@dataclass(frozen=True)
class Reached:
    """One run. time: training seconds at the first scored moment at the level or better, None without one. before: the
    moment scored before that one, 0 without one. held: whether the last score still reaches the level."""

    time: float | None
    before: float = 0.0
    held: bool = False


@dataclass(frozen=True)
class ReachCell:
    """Seconds over the seeds of a series: median, low, high, infinite where the level wasn't reached. count: seeds that
    reached it. lost: how many of these have a worse score at the end."""

    median: float
    low: float
    high: float
    seeds: int
    count: int
    lost: int

    @property
    def text(self) -> str:
        """A text such as "42.1 s (40.0 s to 45.2 s)" or "not reached"."""
        if not math.isfinite(self.median):
            return "not reached" + (f" ({self.count} of {self.seeds} seeds did)" if self.count else "")
        text = seconds_text(self.median)
        if self.seeds > 1:
            high = seconds_text(self.high) if math.isfinite(self.high) else "not reached"
            text += f" ({seconds_text(self.low)} to {high})"
        if self.lost:
            text += ", lost again" + (f" by {self.lost} of {self.seeds}" if self.seeds > 1 else "")
        return text


def reached(run: Curve, level: float, *, higher_is_better: bool) -> Reached:
    """The first moment at which a run reaches the level; a run that failed reaches none."""
    before = 0.0
    for time, score in run.points if run.status is Status.OK else ():
        if _at_least(score, level, higher_is_better):
            return Reached(time, before, _at_least(run.points[-1][1], level, higher_is_better))
        before = time
    return Reached(None)


def reach_cell(series: Series, level: float, *, higher_is_better: bool) -> ReachCell:
    """Median and range over the seeds."""
    found = [reached(run, level, higher_is_better=higher_is_better) for run in series.runs]
    times = [math.inf if one.time is None else one.time for one in found]
    there = [one for one in found if one.time is not None]
    lost = sum(not one.held for one in there)
    return ReachCell(statistics.median(times), min(times), max(times), len(times), len(there), lost)


def levels(series: Sequence[Series], *, higher_is_better: bool) -> tuple[float, ...]:
    """Levels at `_SHARES` of the way from the worst first score to the best median, each rounded to the easier side;
    none if no run improves its score."""
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


def _at_least(score: float, level: float, higher_is_better: bool) -> bool:
    return score >= level if higher_is_better else score <= level


def seconds_text(seconds: float) -> str:
    """Seconds with three significant digits, and at most two decimals."""
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
