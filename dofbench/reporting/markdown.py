"""leaderboard.md: tables that explain every gap, and say how each number was made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dofbench.harness.methods import find_method, method_files
from dofbench.harness.protocol import PROTOCOLS
from dofbench.reporting.collect import Collection, Entry, board_names, grouped, variant_names
from dofbench.reporting.columns import COLUMNS, SCORES
from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.held_out import ASKED_HEADING, asked_table
from dofbench.reporting.lenses import HELD_OUT, lens_words
from dofbench.reporting.line_table import Beside, line_table, plain
from dofbench.reporting.summary import Line, do_nothing_line, scene_mean, sorted_lines, variant_line

_INTRODUCTION = """\
Best in bold. Where runs differ only in their seed, a cell is mean ± sample standard deviation over the
seeds. A cell that a method can't have is –, with the reason below; a run that failed shows how. Results
of different protocols, or of different versions of a dataset, never share a table. The do-nothing line
is what a predictor of the lens scores that learns nothing; an error above it is worse than no learning."""


def leaderboard_markdown(
    collection: Collection, blocks: dict[tuple[str, ...], Callable[[Footnotes], list[str]]]
) -> str:
    """The page. blocks: board -> writes the lines below its tables: costs, plots, times to reach a score, pictures."""
    entries = collection.entries
    notes = Footnotes()
    names, boards = variant_names(entries), board_names(entries)
    page = ["# Leaderboard", "", _INTRODUCTION, ""]
    by_kind: dict[str, dict[str, dict[tuple[str, ...], Line]]] = {}
    for board, members in grouped(entries, "board").items():
        lenses = next((entry.lenses for entry in members if entry.lenses), None)
        held_out = lenses is not None and lenses["assign"] == HELD_OUT
        kind = f"{board[2]}, held-out focus" if held_out else board[2]
        lines = {variant: variant_line(seeds, names, list(SCORES))
                 for variant, seeds in grouped(members, "variant").items()}
        by_kind.setdefault(kind, {})[boards[board]] = lines
        shown = list(lines.values())
        if (nothing := do_nothing_line(members, list(SCORES))) is not None:
            shown.append(nothing)
        page += [f"## {boards[board]}, {kind}", "",
                 f"Scene {members[0].scene}; dataset checksum {board[1][:16]}{_lenses(board[2], lenses)}.", "",
                 *_board(shown, notes), ""]
        if held_out:
            groups = [(*names[variant], seeds) for variant, seeds in grouped(members, "variant").items()]
            if asked := asked_table(groups, notes):
                page += [f"### {ASKED_HEADING}", "", *asked, ""]
        page += blocks[board](notes)
    for kind, scenes in by_kind.items():
        if len(scenes) > 1:
            page += [f"## Means over scenes, {kind}", "", f"Scenes: {', '.join(scenes)}.", "",
                     *_scene_means(scenes, notes), ""]
    page += _claims(entries, notes)
    page += ["## What the columns say", "",
             *(f"- {column.label} ({column.id}): {column.note}." for column in COLUMNS.values()), ""]
    page += _how_made(entries, boards, names)
    if collection.unreadable:
        page += ["## Results that can't be read", "", *(f"- {problem}" for problem in collection.unreadable), ""]
    return "\n".join([*page, *notes.lines()]).rstrip() + "\n"


def _lenses(protocol: str, lenses: dict[str, Any] | None) -> str:
    if lenses is None:
        return ""
    known = PROTOCOLS.get(protocol)
    sharp = known is not None and known.inputs == "all-in-focus"
    return "; trained on the sharp originals" if sharp else f"; {lens_words(lenses)}"


def _board(lines: list[Line], notes: Footnotes) -> list[str]:
    return line_table(sorted_lines(lines), SCORES, notes, before=_names("seeds"))


def _names(last: str) -> Beside:
    return Beside(["method", "preset", last], lambda line: [line.method, plain(line.preset), line.seeds])


def _scene_means(scenes: dict[str, dict[tuple[str, ...], Line]], notes: Footnotes) -> list[str]:
    variants = sorted({variant for lines in scenes.values() for variant in lines})
    means = []
    for variant in variants:
        own = {scene: lines[variant] for scene, lines in scenes.items() if variant in lines}
        some = next(iter(own.values()))
        cells = {column: scene_mean(own, list(scenes), column) for column in SCORES}
        means.append(Line(some.method, some.preset, f"{len(own)} of {len(scenes)}", cells))
    return line_table(sorted_lines(means), SCORES, notes, before=_names("scenes"))


def _claims(entries: tuple[Entry, ...], notes: Footnotes) -> list[str]:
    """What the authors say of their methods; a table of its own, as data and metrics aren't ours."""
    installed = method_files()
    used = sorted({entry.spec.method for entry in entries})
    cards = {method: find_method(method).card for method in used if method in installed}
    claims = {method: card.claims for method, card in cards.items() if card.claims is not None}
    if not claims:
        return []
    columns = list(dict.fromkeys(
        column for claim in claims.values() for row in claim.rows.values() for column in row))
    rows = []
    for method, claim in claims.items():
        silent = f"{claim.source} gives no such figure"
        for measured_on, values in claim.rows.items():
            figures = [f"{values[column]:g}" if column in values else f"–{notes.mark(silent)}" for column in columns]
            rows.append([method, plain(measured_on), *figures, plain(claim.source)])
    labels = [COLUMNS[column].heading if column in COLUMNS else column for column in columns]
    return ["## Published by the authors, on their own data", "",
            "Not measured here, and not comparable with the tables above digit by digit.", "",
            *table(["method", "measured on", *labels, "source"], rows, left=2), ""]


def _how_made(
    entries: tuple[Entry, ...], boards: dict[tuple[str, ...], str], names: dict[tuple[str, ...], tuple[str, str]]
) -> list[str]:
    """Command, code and machine of every run; the rest is in its result.json."""
    machines: dict[str, int] = {}
    rows = []
    for entry in entries:
        method, preset = names[entry.variant]
        machine = commit = "unknown"
        command = "unknown"
        if entry.result is not None:
            described = machine_text(entry)
            machine = str(machines.setdefault(described, len(machines) + 1))
            command = f"`{entry.result.command}`"
            commit = commit_text(entry)
        rows.append([boards[entry.board], method, plain(preset), str(entry.spec.seed), str(entry.status),
                     entry.spec.budget, plain(command), entry.spec.key[:8], entry.spec.code.rpartition("+")[2][:8],
                     commit, machine])
    heading = ["dataset", "method", "preset", "seed", "status", "budget", "command", "key", "code", "commit", "machine"]
    lines = ["## How these were made", "", *table(heading, rows, left=len(heading)), ""]
    lines += [f"- Machine {number}: {described}" for described, number in machines.items()]
    return [*lines, ""]


def commit_text(entry: Entry) -> str:
    """The commit of a run that left a result."""
    assert entry.result is not None
    git = entry.result.git
    return "no checkout" if git is None else git.commit[:12] + (" + changes" if git.dirty else "")


def machine_text(entry: Entry) -> str:
    """The machine of a run that left a result."""
    assert entry.result is not None
    facts = entry.result.machine
    parts = [f"{facts['cpu']}, {facts['cores']} cores, {facts['memory_gib']} GiB", str(facts["os"]),
             f"Python {facts['python']}"]
    if "accelerator" in facts:
        parts.append(str(facts["accelerator"]))
    return ", ".join(parts)

