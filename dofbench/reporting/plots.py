"""One plot against training time for every score and board, and for the means over boards: curves, Pareto front,
levels to reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

from dofbench.core.evidence import ROLE_WORDS, Role
from dofbench.evaluation.results.collecting import Entry, grouped
from dofbench.evaluation.results.columns import COLUMNS, Column
from dofbench.reporting import standing
from dofbench.reporting.boards import Board, by_kind, mean_name
from dofbench.reporting.pareto import FrontPoint, front_of
from dofbench.reporting.reach import levels
from dofbench.reporting.series import Series, curve_columns, mean_series, series_of


@dataclass(frozen=True)
class Plot:
    """The plot of one score on one board, or of its means over several. dataset: the board's name, or whose mean it is.
    scene: "" of several. role: of the scene. series: the best last score first. levels: scores for which times are
    reported; chosen: whether the user chose them. nothing: the score of a lens predictor that learns nothing."""

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

    @property
    def protocol(self) -> str:
        """The protocol under which the board's runs were scored."""
        return self.board[2]

    @property
    def title(self) -> str:
        """The board's name and protocol, and the role of its scene where one is stated; of a mean its name has it."""
        role = ROLE_WORDS[self.role] if self.scene else ""
        return ", ".join(filter(None, (self.dataset, self.protocol, role)))

    @property
    def score(self) -> Column:
        """The column that is plotted."""
        return COLUMNS[self.column]

    @property
    def higher_is_better(self) -> bool:
        """Whether higher scores are better."""
        return bool(self.score.higher_is_better)


def make_plots(
    entries: Sequence[Entry],
    names: dict[tuple[str, ...], tuple[str, str]],
    boards: dict[tuple[str, ...], str],
    wanted: dict[str, tuple[float, ...]],
) -> tuple[Plot, ...]:
    """The plots of every board, for the scores that its curves have. wanted: score -> levels, which replace
    automatically chosen ones."""
    return tuple(
        plot
        for board, members in grouped(list(entries), "board").items()
        for plot in _board_plots(board, members, names, boards[board], wanted)
    )


def mean_plots(
    boards: Sequence[Board], plots: Sequence[Plot], wanted: dict[str, tuple[float, ...]]
) -> tuple[Plot, ...]:
    """The plots of the means over the boards of each kind that has several, for scores that all of them have. plots: of
    the boards. wanted: as of `make_plots`."""
    return tuple(
        plot
        for kind, scenes in by_kind(boards).items()
        if len(scenes) > 1
        for plot in _mean_plots(kind, scenes, plots, wanted)
    )


def _board_plots(
    board: tuple[str, ...],
    members: list[Entry],
    names: dict[tuple[str, ...], tuple[str, str]],
    dataset: str,
    wanted: dict[str, tuple[float, ...]],
) -> Iterator[Plot]:
    nothing = next((entry.result.do_nothing for entry in members if entry.result and entry.result.do_nothing), {})
    role = standing.role_of(members)
    for column in curve_columns(members):
        if series := series_of(members, column, names):
            yield _plot(board, dataset, members[0].scene, role, column, series, nothing.get(column), wanted)


def _mean_plots(
    kind: str, boards: Sequence[Board], plots: Sequence[Plot], wanted: dict[str, tuple[float, ...]]
) -> Iterator[Plot]:
    protocol, role = boards[0].protocol, boards[0].role
    name = mean_name(kind, boards)
    keys = {board.key for board in boards}
    for column in COLUMNS:
        own = [plot for plot in plots if plot.column == column and plot.board in keys]
        if len(own) == len(boards) and (series := mean_series([plot.series for plot in own])):
            known = [plot.nothing for plot in own if plot.nothing is not None]
            nothing = fmean(known) if len(known) == len(own) else None
            yield _plot(("means", kind, protocol), name, "", role, column, series, nothing, wanted)


def _plot(
    board: tuple[str, ...],
    dataset: str,
    scene: str,
    role: Role | None,
    column: str,
    series: tuple[Series, ...],
    nothing: float | None,
    wanted: dict[str, tuple[float, ...]],
) -> Plot:
    higher = bool(COLUMNS[column].higher_is_better)
    series = tuple(sorted(series, key=lambda one: one.rank(higher_is_better=higher)))
    return Plot(
        board,
        dataset,
        scene,
        role,
        column,
        series,
        front_of(series, higher_is_better=higher),
        wanted.get(column) or levels(series, higher_is_better=higher),
        column in wanted,
        nothing,
    )
