"""Results by board, with what every section of the page needs of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.errors import Status
from dofbench.harness.protocol import PROTOCOLS
from dofbench.reporting.collect import Entry, board_names, grouped, variant_names
from dofbench.reporting.columns import COST, SCORES, Column
from dofbench.reporting.lenses import HELD_OUT, lens_words
from dofbench.reporting.summary import Cell, Line, do_nothing_line, spread_cell, variant_line

Variant = tuple[str, ...]

# Beside the columns that results have by name; from the stages that they time.
COLD_START = Column("warm_up_s", "cold start", "s", None, 1,
                    "wall time of a first step before training, which compiles kernels where they aren't cached; in no "
                    "other figure")
TRAIN_CPU = Column("train_cpu_s", "training, CPU", "s", None, 1, "CPU time of training, summed over threads")
_STAGES = {COLD_START.id: ("warm up", "wall"), TRAIN_CPU.id: ("train", "cpu")}
COST_COLUMNS = ("train_s", TRAIN_CPU.id, COLD_START.id, *(column for column in COST if column != "train_s"))


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
    lines = {variant: _line(seeds, names) for variant, seeds in grouped(members, "variant").items()}
    return Board(key, name, members[0].scene, f"{key[2]}, held-out focus" if held_out else key[2], sharp, held_out,
                 trained_on, tuple(members), lines, do_nothing_line(members, list(SCORES)))


def _line(seeds: list[Entry], names: dict[Variant, tuple[str, str]]) -> Line:
    line = variant_line(seeds, names, list(SCORES))
    for column in _STAGES:
        line.cells.setdefault(column, _stage_cell(seeds, column))
    return line


def _stage_cell(seeds: list[Entry], column: str) -> Cell:
    """Seconds of a stage over the seeds; as with scores, none where a seed failed."""
    failed = [entry for entry in seeds if entry.status is not Status.OK]
    if failed:
        kinds = ", ".join(sorted({str(entry.status) for entry in failed}))
        return Cell(None, failure=kinds, reason=failed[0].message or "no message")
    stage, part = _STAGES[column]
    times = [getattr(entry.result.stages[stage], part) for entry in seeds
             if entry.result is not None and stage in entry.result.stages]
    if len(times) < len(seeds):
        return Cell(None, reason=f"the result doesn't time the stage {stage!r}")
    return spread_cell(times)
