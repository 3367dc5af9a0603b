"""Results by board, with what every section of the page needs of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.reporting.summary import Line, do_nothing_line, variant_line
from dofbench.results.collecting import Entry, board_names, grouped, variant_names
from dofbench.results.columns import SCORES
from dofbench.results.lens_columns import HELD_OUT, lens_words
from dofbench.results.protocol import PROTOCOLS

Variant = tuple[str, ...]


@dataclass(frozen=True)
class Board:
    """One dataset under one protocol. name: the dataset's, told apart from its other versions. kind: boards of one kind
    may be averaged. lines: variant -> its scores and costs. nothing: the predictor that learns nothing."""

    key: tuple[str, ...]
    name: str
    scene: str
    kind: str
    sharp: bool
    held_out: bool
    trained_on: str
    members: tuple[Entry, ...]
    lines: dict[Variant, Line]
    nothing: Line | None


def gather(entries: Sequence[Entry]) -> list[Board]:
    """The boards in their order."""
    every = tuple(entries)
    names, boards = variant_names(every), board_names(every)
    return [_board(key, boards[key], members, names) for key, members in grouped(every, "board").items()]


def by_kind(boards: Sequence[Board]) -> dict[str, list[Board]]:
    """The boards that may stand in one table and be averaged."""
    found: dict[str, list[Board]] = {}
    for board in boards:
        found.setdefault(board.kind, []).append(board)
    return found


def _board(key: tuple[str, ...], name: str, members: list[Entry], names: dict[Variant, tuple[str, str]]) -> Board:
    protocol = PROTOCOLS.get(key[2])
    sharp = protocol is not None and protocol.inputs == "all-in-focus"
    lenses = next((entry.lenses for entry in members if entry.lenses), None)
    held_out = lenses is not None and lenses["assign"] == HELD_OUT
    trained_on = "sharp originals" if sharp else "shallow photographs"
    if lenses is not None and not sharp:
        trained_on += f" of {lens_words(lenses).removeprefix('trained on ')}"
    lines = {
        variant: variant_line(seeds, names, list(SCORES)) for variant, seeds in grouped(members, "variant").items()
    }
    return Board(
        key,
        name,
        members[0].scene,
        f"{key[2]}, held-out focus" if held_out else key[2],
        sharp,
        held_out,
        trained_on,
        tuple(members),
        lines,
        do_nothing_line(members, list(SCORES)),
    )
