"""Results grouped into boards, which hold the runs on one dataset under one protocol; and means over several boards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dofbench.core.evidence import PHOTOGRAPHER_WORDS, ROLE_WORDS, Photographer, Role
from dofbench.evaluation.results.collecting import Entry, added_columns, board_names, grouped, variant_names
from dofbench.evaluation.results.columns import SCORES
from dofbench.evaluation.results.lens_columns import HELD_OUT, lens_words
from dofbench.evaluation.results.protocol import PROTOCOLS
from dofbench.reporting import standing
from dofbench.reporting.points_seen import points_of
from dofbench.reporting.summary import Line, do_nothing_line, scene_mean, scene_spread, variant_line

Variant = tuple[str, ...]


@dataclass(frozen=True)
class Board:
    """One dataset under one protocol. name: the dataset's, distinguished from other versions of the dataset. role, of
    the scene, and photographer: None where no result states them, photographer also for methods that train on sharp
    originals. scored: the protocol in words. kind: protocol, role and photographer in words; boards of one kind may be
    averaged. lenses: those of the training views, in words, "" if no result states them. variants: variant -> its
    seeds. lines: variant -> its scores and costs. nothing: the line of the predictor that learns nothing."""

    key: tuple[str, ...]
    name: str
    scene: str
    role: Role | None
    photographer: Photographer | None
    scored: str
    kind: str
    sharp: bool
    held_out: bool
    lenses: str
    variants: dict[Variant, list[Entry]]
    lines: dict[Variant, Line]
    nothing: Line | None

    @property
    def protocol(self) -> str:
        """The protocol under which all runs of the board were scored."""
        return self.key[2]

    @property
    def checksum(self) -> str:
        """The dataset's checksum, shortened."""
        return self.key[1][:16]

    @property
    def title(self) -> str:
        """Dataset and protocol."""
        return f"{self.name}, {self.scored}"

    @property
    def members(self) -> tuple[Entry, ...]:
        """The runs of the board."""
        return tuple(entry for seeds in self.variants.values() for entry in seeds)

    @property
    def trained_on(self) -> str:
        """A text such as "shallow photographs of F 0.2, 0.8 and A 1; the test views ask for F 0.5 and A 0"."""
        if self.sharp:
            return "sharp originals"
        return "shallow photographs" + (f" of {self.lenses.removeprefix('trained on ')}" if self.lenses else "")


def score_columns(entries: Sequence[Entry]) -> list[str]:
    """The columns of a page about these runs: scores that all runs have, then scores added to at least one run."""
    return [*SCORES, *added_columns(entries)]


def gather(entries: Sequence[Entry]) -> list[Board]:
    """The boards of these runs, in the order of the page: report scenes first, then by what took the photographs."""
    every = tuple(entries)
    names, boards, columns = variant_names(every), board_names(every), score_columns(every)
    found = [_board(key, boards[key], members, names, columns) for key, members in grouped(every, "board").items()]
    return sorted(found, key=lambda board: standing.place(board.role, board.photographer))  # stable


def by_kind(boards: Sequence[Board]) -> dict[str, list[Board]]:
    """Kind -> the boards of this kind, which may stand in one table and be averaged."""
    found: dict[str, list[Board]] = {}
    for board in boards:
        found.setdefault(board.kind, []).append(board)
    return found


def mean_name(kind: str, boards: Sequence[Board]) -> str:
    """What the mean over several boards of one kind is called where datasets have their names."""
    return f"the mean over {len(boards)} scenes{kind.removeprefix(boards[0].protocol)}"


def mean_lines(boards: Sequence[Board], columns: Sequence[str]) -> dict[Variant, Line]:
    """Means over several boards of one kind, for variants that have a score on every board. The spread is the standard
    deviation of this mean over seeds that all boards have."""
    scenes = [board.name for board in boards]
    means = {}
    for variant in sorted({variant for board in boards for variant in board.lines}):
        own = {board.name: board.lines[variant] for board in boards if variant in board.lines}
        runs = [board.variants[variant] for board in boards if variant in board.variants]
        some = next(iter(own.values()))
        cells = {column: scene_mean(own, scenes, column) for column in columns}
        cells = {
            column: cell if cell.value is None else replace(cell, spread=scene_spread(runs, column))
            for column, cell in cells.items()
        }
        same = len({line.seeds for line in own.values()}) == 1
        seeds = some.seeds if same else "not the same on all"
        signs = standing.united(line.signs for line in own.values())
        means[variant] = Line(some.method, some.preset, seeds, cells, signs=signs)
    return means


def _board(
    key: tuple[str, ...], name: str, members: list[Entry], names: dict[Variant, tuple[str, str]], columns: list[str]
) -> Board:
    protocol = PROTOCOLS.get(key[2])
    lenses = next((entry.lenses for entry in members if entry.lenses), None)
    held_out = lenses is not None and lenses["assign"] == HELD_OUT
    variants = grouped(members, "variant")
    sharp = protocol is not None and protocol.inputs == "all-in-focus"
    role, photographer = standing.role_of(members), None if sharp else standing.photographer_of(members)
    points = points_of(members)
    kind = (key[2], "held-out focus" if held_out else "", "" if points is None else points.protocol)
    scored = ", ".join(filter(None, kind))
    return Board(
        key,
        name,
        members[0].scene,
        role,
        photographer,
        scored,
        ", ".join(filter(None, (scored, ROLE_WORDS[role], PHOTOGRAPHER_WORDS[photographer]))),
        sharp,
        held_out,
        "" if lenses is None else lens_words(lenses),
        variants,
        {
            variant: variant_line(seeds, names, columns, standing.signs(role, seeds))
            for variant, seeds in variants.items()
        },
        do_nothing_line(members, columns),
    )
