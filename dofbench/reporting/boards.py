"""Results grouped into boards (one dataset under one protocol): rows with means over seeds, means over scenes, the
reason of every gap, and signs for what a result doesn't prove."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dofbench.core.evidence import PHOTOGRAPHER_WORDS, PHOTOGRAPHERS, ROLE_WORDS, ROLES, Photographer, Role
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.evaluation.comparing.means import Statistic, scene_mean, seed_mean
from dofbench.evaluation.comparing.photograph_notes import undetermined
from dofbench.evaluation.comparing.score_curves import uneven_clocks
from dofbench.evaluation.results.collecting import Entry, added_columns, board_names, grouped, variant_names
from dofbench.evaluation.results.columns import COLUMNS, HELD_OUT, SCORES, lens_words
from dofbench.evaluation.results.protocol import EXIF_COLUMNS, PROTOCOLS
from dofbench.methods.cards import find_method, method_files
from dofbench.methods.frozen_presets import State, state_of

DO_NOTHING = "do nothing (Â = F̂ = 0.5)"
DEVELOPMENT, NOT_FROZEN, CHANGED, OTHER_BUDGET, STAND_IN = "†", "‡", "§", "¶", "◊"
# Sign -> its note below every table that has it, in this order
NOTES = {
    DEVELOPMENT: f"{DEVELOPMENT} Tuning scene: presets were chosen on it, so it shows nothing about other scenes.",
    NOT_FROZEN: f"{NOT_FROZEN} Preset not fixed before this test scene was run.",
    CHANGED: f"{CHANGED} Not the fixed preset: options or their defaults differ.",
    OTHER_BUDGET: f"{OTHER_BUDGET} Fixed preset under another budget than its own.",
    STAND_IN: f"{STAND_IN} Something stands in for a part of the method: `dofbench methods METHOD` says for which.",
}
_SIGN_OF_STATE: dict[State, str] = {
    "frozen": "",
    "other budget": OTHER_BUDGET,
    "not frozen": NOT_FROZEN,
    "changed": CHANGED,
}

# Short forms in CSV files and names of files, the same in every version
_IN_FILES = {
    "report": "report scene",
    "development": "development scene",
    "thinlens": "sampled lens",
    "unknown": "unknown lens",
    "layered": "layers",
    "light-field": "light field",
}

Variant = tuple[str, ...]
Names = Mapping[Variant, tuple[str, str]]  # variant -> (method, preset) as shown


@dataclass(frozen=True)
class Line:
    """One row of a table: cells by column. competes: whether it can be the best. signs: as in `NOTES`."""

    method: str
    preset: str
    seeds: str
    cells: dict[str, Statistic]
    competes: bool = True
    signs: str = ""

    @property
    def name(self) -> str:
        """Method and preset."""
        return f"{self.method} {self.preset}".strip()


@dataclass(frozen=True)
class Board:
    """One dataset under one protocol.

    name: the dataset's, with a checksum where versions differ. role, of the scene; photographer: how the input images
    were made, None for all-in-focus inputs; points: what methods start from; each None where no result states it.
    scored: the protocol in words. kind: protocol, role and photographer in words; only boards of one kind are averaged.
    sharp: whether methods trained on all-in-focus images. held_out: whether the test views have a focus that no
    training view has. lenses: of the views in words, "" where no result states them. variants: variant -> its seeds.
    lines: variant -> its scores and costs. nothing: the lens predictor that learns nothing. by_cpu: whether times are
    compared as processor time (`uneven_clocks`, of any board of the kind).
    """

    key: tuple[str, ...]
    name: str
    members: Sequence[Entry]
    role: Role | None
    photographer: Photographer | None
    points: PointsRecord | None
    scored: str
    kind: str
    sharp: bool
    held_out: bool
    lenses: str
    variants: dict[Variant, list[Entry]]
    lines: dict[Variant, Line]
    nothing: Line | None
    by_cpu: bool = False

    @property
    def protocol(self) -> str:
        """The protocol under which all runs of the board were scored."""
        return self.key[2]

    @property
    def scene(self) -> str:
        """The scene that the dataset was made from."""
        return self.members[0].scene

    @property
    def title(self) -> str:
        """Dataset and protocol."""
        return f"{self.name}, {self.scored}"


def gather(entries: Sequence[Entry]) -> list[Board]:
    """The boards of these runs: test scenes first, and ray-traced or real defocus before synthetic defocus."""
    every = tuple(entries)
    names, boards, columns = variant_names(every), board_names(every), score_columns(every)
    found = [_board(key, boards[key], members, names, columns) for key, members in grouped(every, "board").items()]
    uneven = {board.kind for board in found if uneven_clocks(board.members)}
    found = [replace(board, by_cpu=board.kind in uneven) for board in found]
    return sorted(found, key=lambda board: (ROLES.index(board.role), PHOTOGRAPHERS.index(board.photographer)))


def _board(key: tuple[str, ...], name: str, members: Sequence[Entry], names: Names, columns: Sequence[str]) -> Board:
    protocol, role = PROTOCOLS.get(key[2]), role_of(members)
    sharp = protocol is not None and protocol.inputs == "all-in-focus"
    photographers = (entry.result.photographer for entry in members if entry.result and entry.result.photographer)
    photographer = None if sharp else next(photographers, None)
    points = next((entry.points for entry in members if entry.points is not None), None)
    lenses = next((entry.lenses for entry in members if entry.lenses), None)
    held_out = lenses is not None and lenses["assign"] == HELD_OUT
    parts = key[2], "held-out focus" if held_out else "", points.protocol if points else ""
    scored = ", ".join(filter(None, parts))
    kind = ", ".join(filter(None, (scored, ROLE_WORDS[role], PHOTOGRAPHER_WORDS[photographer])))
    words, variants = lens_words(lenses) if lenses else "", grouped(list(members), "variant")
    lines = {one: variant_line(seeds, names[one], columns, signs_of(role, seeds)) for one, seeds in variants.items()}
    for one, reason in undetermined(variants).items():
        lines[one].cells.update(dict.fromkeys(EXIF_COLUMNS, Statistic(None, reason=reason)))
    scene = role, photographer, points, scored, kind, sharp, held_out, words
    return Board(key, name, members, *scene, variants, lines, _do_nothing(members, columns))


def score_columns(entries: Sequence[Entry]) -> list[str]:
    """The columns of a page: scores that all runs have, then scores added to at least one run."""
    return [*SCORES, *added_columns(entries)]


def mean_names(kind: str, boards: Sequence[Board]) -> tuple[str, str]:
    """The name of the mean over boards of one kind, in place of a dataset's: (on pages, in files)."""
    first, mean = boards[0], f"the mean over {len(boards)} scenes"
    words = (f", {_IN_FILES.get(one, one)}" for one in (first.role, first.photographer) if one)
    return mean + kind.removeprefix(first.protocol), mean + first.scored.removeprefix(first.protocol) + "".join(words)


def variant_line(entries: Sequence[Entry], name: tuple[str, str], columns: Sequence[str], signs: str = "") -> Line:
    """The row of one variant: all of its seeds on one dataset."""
    cells = {column: seed_mean(entries, column) for column in columns}
    seeds = [str(entry.spec.seed) for entry in entries]
    shown = ", ".join(seeds) + (f" (n = {len(seeds)})" if len(seeds) > 1 else "")
    return Line(*name, shown, cells, signs=signs)


def _do_nothing(entries: Sequence[Entry], columns: Sequence[str]) -> Line | None:
    known = next((entry.result.do_nothing for entry in entries if entry.result and entry.result.do_nothing), None)
    if known is None:
        return None
    gap = Statistic(None, reason="not a method: it only predicts A = F = 0.5 for every lens")
    cells = {column: Statistic(known[column]) if column in known else gap for column in columns}
    return Line(DO_NOTHING, "", "", cells, competes=False)


def sorted_lines(lines: Sequence[Line]) -> list[Line]:
    """Best refocus PSNR first; then lines without it, by all-in-focus PSNR (of real photographs, by their PSNR);
    failures last."""

    def place(line: Line) -> tuple[Any, ...]:
        values = [line.cells[column].value for column in ("psnr", "aif_psnr", "photo_psnr", "across_psnr")
                  if column in line.cells]  # fmt: skip
        refocus, sharp = values[0], next((value for value in values[1:] if value is not None), None)
        none = refocus is None and sharp is None
        return (not line.competes, none, refocus is None, -_rank(refocus), -_rank(sharp), line.method, line.preset)

    return sorted(lines, key=place)


def _rank(value: float | None) -> float:
    return -math.inf if value is None or math.isnan(value) else value


def best_texts(lines: Sequence[Line], columns: Sequence[str]) -> dict[str, str | None]:
    """Column -> best value as shown, so that values that look equal are all marked."""
    found = {}
    for column in columns:
        values = [line.cells[column].value for line in lines if line.competes]
        found[column] = COLUMNS[column].best([value for value in values if value is not None])
    return found


def empty_columns(lines: Sequence[Line], columns: Sequence[str]) -> dict[str, str]:
    """Columns without a value or failure in any competing line -> the reasons, "" where another protocol has them."""
    empty = {}
    for column in columns:
        cells = [line.cells[column] for line in lines if line.competes]
        if cells and not any(cell.value is not None or cell.failure for cell in cells):
            empty[column] = "; ".join(dict.fromkeys(cell.reason for cell in cells if cell.reason))
    return empty


def mean_lines(boards: Sequence[Board], columns: Sequence[str]) -> dict[Variant, Line]:
    """Means over several boards of one kind; gaps for variants that a board lacks. The spread is the standard deviation
    of this mean over seeds that all boards have."""
    scenes = [board.name for board in boards]
    means = {}
    for variant in sorted({variant for board in boards for variant in board.lines}):
        own = {board.name: board.lines[variant] for board in boards if variant in board.lines}
        runs = [board.variants[variant] for board in boards if variant in board.variants]
        cells = {
            column: scene_mean({name: line.cells[column] for name, line in own.items()}, scenes, runs, column)
            for column in columns
        }
        first = next(iter(own.values()))
        seeds = first.seeds if len({line.seeds for line in own.values()}) == 1 else "not the same on all"
        signs = united(line.signs for line in own.values())
        means[variant] = Line(first.method, first.preset, seeds, cells, signs=signs)
    return means


def role_of(members: Iterable[Entry]) -> Role | None:
    """The role of a board's scene; None where no result states it (a run that died doesn't)."""
    return next((entry.result.role for entry in members if entry.result and entry.result.role), None)


def frozen_state(entry: Entry) -> State:
    """Whether the run was made with a fixed preset."""
    return state_of(entry.spec.method, entry.spec.preset, entry.choices, entry.spec.budget)


def signs_of(role: Role | None, entries: Sequence[Entry]) -> str:
    """The signs of a row with these runs on a scene of this role; the preset counts on test scenes alone."""
    spec = entries[0].spec  # a row's runs share method and options
    replaced = spec.method in method_files() and bool(find_method(spec.method).replaced_parts(spec.options))
    states = (_SIGN_OF_STATE[frozen_state(entry)] for entry in entries) if role == "report" else ()
    return united([DEVELOPMENT * (role == "development"), *states, STAND_IN * replaced])


def united(several: Iterable[str]) -> str:
    """All signs of these texts, each once, in the order of `NOTES`."""
    found = "".join(several)
    return "".join(sign for sign in NOTES if sign in found)
