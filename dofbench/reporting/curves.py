"""Plots of score against training time as plain data: medians over seeds, means over scenes, and their fronts."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dofbench.core.errors import InputError, Status
from dofbench.core.evidence import ROLE_NOT_STATED, ROLE_WORDS, Role
from dofbench.evaluation.comparing.score_curves import (
    Curve,
    FrontPoint,
    Point,
    curve_of,
    joint_curve,
    levels,
    pareto_front,
)
from dofbench.evaluation.figures import LOOKS
from dofbench.evaluation.results.collecting import grouped
from dofbench.evaluation.results.columns import COLUMNS, Column
from dofbench.reporting.boards import Board, Names, Variant, mean_names, united

Levels = Mapping[str, tuple[float, ...]]  # score -> levels that the user asked for


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


@dataclass(frozen=True)
class Plot:
    """The plot of one score on one board, or of its mean over several. scene: "" for a mean. series: best last score
    first. levels: scores to reach; chosen: whether the user chose them. nothing: score of a lens predictor that learns
    nothing. by_cpu: over processor time. in_files: the dataset in files where its name differs. whole: number of series
    before `best` took some."""

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
    by_cpu: bool = False
    in_files: str = ""
    whole: int = 0

    def best(self, most: int) -> Plot:
        """The plot with at most so many series: those on the front, then the best."""
        if len(self.series) <= most:
            return self
        first = dict.fromkeys((*(point.series for point in self.front), *range(len(self.series))))
        kept = {old: new for new, old in enumerate(sorted(list(first)[:most]))}
        front = tuple(point._replace(series=kept[point.series]) for point in self.front if point.series in kept)
        return replace(self, series=tuple(self.series[old] for old in kept), front=front, whole=len(self.series))

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
        where = {"dataset": self.in_files or self.dataset, "protocol": self.protocol, "score": self.column}
        return {**where, "role": self.role or ROLE_NOT_STATED, "clock": "cpu" if self.by_cpu else "wall"}

    @property
    def clock(self) -> str:
        """The time of the plot in words."""
        return "processor time" if self.by_cpu else "training time"

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
                plots.append(_plot(*where, column, series, nothing.get(column), wanted, board.by_cpu))
    return plots


def mean_plots(boards: Sequence[Board], plots: Sequence[Plot], wanted: Levels) -> list[Plot]:
    """The plots of the means over the boards of each kind that has several, for scores that all of them have."""
    means = []
    for kind, scenes in grouped(boards, "kind").items():
        name, in_files = mean_names(kind, scenes)
        where = ("means", kind, scenes[0].protocol), name, "", scenes[0].role
        keys = {board.key for board in scenes}
        for column in COLUMNS if len(scenes) > 1 else ():
            own = [plot for plot in plots if plot.column == column and plot.board in keys]
            if len(own) == len(scenes) and (series := mean_series([plot.series for plot in own])):
                known = [plot.nothing for plot in own if plot.nothing is not None]
                nothing = statistics.fmean(known) if len(known) == len(own) else None
                mean = _plot(*where, column, series, nothing, wanted, scenes[0].by_cpu)
                means.append(replace(mean, in_files=in_files))
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
    by_cpu: bool,
) -> Plot:
    higher = bool(COLUMNS[column].higher_is_better)
    series = tuple(sorted(series, key=lambda one: one.rank(higher_is_better=higher)))
    front = pareto_front([one.median for one in series], higher_is_better=higher)
    runs = [run for one in series for run in one.runs]
    reach = wanted.get(column) or levels(runs, [one.median for one in series], higher_is_better=higher)
    return Plot(board, dataset, scene, role, column, series, front, reach, column in wanted, nothing, by_cpu)


def _series(board: Board, column: str, names: Names) -> list[Series]:
    """The series of one board that have a point."""
    found = []
    # With more variants than looks two lines of one plot could look alike, if places were the report's.
    places = {variant: place for place, variant in enumerate(names if len(names) <= LOOKS else board.variants)}
    for variant, seeds in board.variants.items():
        runs = tuple(curve_of(entry, column, processor=board.by_cpu) for entry in seeds)
        if any(run.points for run in runs):
            whole = all(run.points and run.status is Status.OK for run in runs)
            median = joint_curve([run.points for run in runs], statistics.median) if whole else ()
            signs = board.lines[variant].signs
            found.append(Series(variant, *names[variant], runs, median, places[variant], signs))
    return found


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
