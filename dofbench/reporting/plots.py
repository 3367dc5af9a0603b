"""One plot against training time for every score and board: curves, Pareto front, levels to reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from dofbench.core.evidence import ROLE_WORDS, Role
from dofbench.reporting import standing
from dofbench.reporting.pareto import FrontPoint, front_of
from dofbench.reporting.reach import levels
from dofbench.reporting.series import Series, curve_columns, series_of
from dofbench.results.collecting import Entry, grouped
from dofbench.results.columns import COLUMNS, Column


@dataclass(frozen=True)
class Plot:
    """The plot of one score on one board. dataset: the board's name. role: of its scene. levels: scores for which times
    are reported; chosen: whether the user chose them. nothing: the score of a lens predictor that learns nothing."""

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
        """The board's name and protocol, and the role of its scene where one is stated."""
        return ", ".join(filter(None, (self.dataset, self.protocol, ROLE_WORDS[self.role])))

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


def _board_plots(
    board: tuple[str, ...],
    members: list[Entry],
    names: dict[tuple[str, ...], tuple[str, str]],
    dataset: str,
    wanted: dict[str, tuple[float, ...]],
) -> Iterator[Plot]:
    nothing = next((entry.result.do_nothing for entry in members if entry.result and entry.result.do_nothing), {})
    for column in curve_columns(members):
        series = series_of(members, column, names)
        if not series:
            continue
        higher = bool(COLUMNS[column].higher_is_better)
        yield Plot(
            board,
            dataset,
            members[0].scene,
            standing.role_of(members),
            column,
            series,
            front_of(series, higher_is_better=higher),
            wanted.get(column) or levels(series, higher_is_better=higher),
            column in wanted,
            nothing.get(column),
        )
