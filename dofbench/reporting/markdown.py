"""leaderboard.md: tables that explain every gap, and say how each number was made."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.held_out import ASKED_HEADING, asked_table
from dofbench.reporting.line_table import Beside, line_table, plain
from dofbench.reporting.pairwise import HEADING as PAIRWISE
from dofbench.reporting.pairwise import Seeds, board_pairs, explanation, pairwise_table, scene_pairs
from dofbench.reporting.summary import (
    Line,
    do_nothing_line,
    scene_mean,
    scene_spread,
    sorted_lines,
    variant_line,
)
from dofbench.results.collecting import Collection, Entry, added_columns, board_names, grouped, variant_names
from dofbench.results.columns import COLUMNS, SCORES
from dofbench.results.lens_columns import HELD_OUT, lens_words
from dofbench.results.protocol import PROTOCOLS
from dofbench.running.method_cards import find_method, method_files

_INTRODUCTION = """\
Best in bold, which alone doesn't make it better: see the differences below each table. Where runs differ
only in their seed, a cell is mean ± sample standard deviation over the n seeds; without ±, there was one, and
no spread is known. A cell that a method can't have is –, with the reason below; a run that failed shows how. Results
of different protocols, or of different versions of a dataset, never share a table. The do-nothing line
is what a predictor of the lens scores that learns nothing; an error above it is worse than no learning."""


def leaderboard_markdown(collection: Collection, blocks: dict[tuple[str, ...], list[str]]) -> str:
    """The page. blocks: board -> the lines below its tables: plots, times to reach a score, pictures."""
    entries = collection.entries
    notes = Footnotes()
    names, boards = variant_names(entries), board_names(entries)
    columns = [*SCORES, *added_columns(entries)]
    page = ["# Leaderboard", "", _INTRODUCTION, ""]
    by_kind: dict[str, dict[str, tuple[dict[tuple[str, ...], Line], Seeds]]] = {}
    compared = False
    for board, members in grouped(entries, "board").items():
        lenses = next((entry.lenses for entry in members if entry.lenses), None)
        held_out = lenses is not None and lenses["assign"] == HELD_OUT
        kind = f"{board[2]}, held-out focus" if held_out else board[2]
        variants = grouped(members, "variant")
        lines = {variant: variant_line(seeds, names, columns) for variant, seeds in variants.items()}
        by_kind.setdefault(kind, {})[boards[board]] = lines, variants
        shown = list(lines.values())
        if (nothing := do_nothing_line(members, columns)) is not None:
            shown.append(nothing)
        page += [
            f"## {boards[board]}, {kind}",
            "",
            f"Scene {members[0].scene}; dataset checksum {board[1][:16]}{_lenses(board[2], lenses)}.",
            "",
            *_board(shown, columns, notes),
            "",
        ]
        if differences := pairwise_table(board_pairs(members), names, notes):
            compared = True
            page += [f"### {PAIRWISE}", "", *differences, ""]
        if held_out:
            groups = [(*names[variant], seeds) for variant, seeds in variants.items()]
            if asked := asked_table(groups, notes):
                page += [f"### {ASKED_HEADING}", "", *asked, ""]
        page += blocks[board]
    for kind, scenes in by_kind.items():
        if len(scenes) > 1:
            page += [
                f"## Means over scenes, {kind}",
                "",
                f"Scenes: {', '.join(scenes)}.",
                "",
                *_scene_means(scenes, columns, notes),
                "",
            ]
            if differences := pairwise_table(scene_pairs([seeds for _, seeds in scenes.values()]), names, notes):
                page += [f"### {PAIRWISE}", "", *differences, ""]
    page += explanation() if compared else []
    page += _claims(entries, notes)
    page += [
        "## What the columns say",
        "",
        *(f"- {COLUMNS[column].label} ({column}): {COLUMNS[column].note}." for column in columns),
        "",
    ]
    page += _added(entries)
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


def _board(lines: list[Line], columns: list[str], notes: Footnotes) -> list[str]:
    return line_table(sorted_lines(lines), columns, notes, before=_names("seeds"))


def _names(last: str) -> Beside:
    return Beside(["method", "preset", last], lambda line: [line.method, plain(line.preset), line.seeds])


def _scene_means(
    scenes: dict[str, tuple[dict[tuple[str, ...], Line], Seeds]],
    columns: list[str],
    notes: Footnotes,
) -> list[str]:
    variants = sorted({variant for lines, _ in scenes.values() for variant in lines})
    means = []
    for variant in variants:
        own = {scene: lines[variant] for scene, (lines, _) in scenes.items() if variant in lines}
        runs = [seeds[variant] for _, seeds in scenes.values() if variant in seeds]
        some = next(iter(own.values()))
        cells = {column: scene_mean(own, list(scenes), column) for column in columns}
        cells = {
            column: cell if cell.value is None else replace(cell, spread=scene_spread(runs, column))
            for column, cell in cells.items()
        }
        same = len({line.seeds for line in own.values()}) == 1
        means.append(Line(some.method, some.preset, some.seeds if same else "not the same on all", cells))
    return line_table(sorted_lines(means), columns, notes, before=_names("seeds"))


def _added(entries: tuple[Entry, ...]) -> list[str]:
    """Which scores were computed after their runs, and by which code."""
    by_code: dict[str, dict[str, None]] = {}
    for entry in entries:
        for column, score in (entry.added.scores if entry.added else {}).items():
            by_code.setdefault(score.code, {})[column] = None
    if not by_code:
        return []
    return [
        "## Added after the runs",
        "",
        "From the pictures and models that they kept, by `dofbench score`.",
        "",
        *(f"- {', '.join(columns)}: by code {code}." for code, columns in by_code.items()),
        "",
    ]


def _claims(entries: tuple[Entry, ...], notes: Footnotes) -> list[str]:
    """What the authors say of their methods; a table of its own, as data and metrics aren't ours."""
    installed = method_files()
    used = sorted({entry.spec.method for entry in entries})
    cards = {method: find_method(method).card for method in used if method in installed}
    claims = {method: card.claims for method, card in cards.items() if card.claims is not None}
    if not claims:
        return []
    columns = list(dict.fromkeys(column for claim in claims.values() for row in claim.rows.values() for column in row))
    rows = []
    for method, claim in claims.items():
        silent = f"{claim.source} gives no such figure"
        for measured_on, values in claim.rows.items():
            figures = [f"{values[column]:g}" if column in values else f"–{notes.mark(silent)}" for column in columns]
            rows.append([method, plain(measured_on), *figures, plain(claim.source)])
    labels = [COLUMNS[column].heading if column in COLUMNS else column for column in columns]
    return [
        "## Published by the authors, on their own data",
        "",
        "Not measured here, and not comparable with the tables above digit by digit.",
        "",
        *table(["method", "measured on", *labels, "source"], rows, left=2),
        "",
    ]


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
        rows.append(
            [
                boards[entry.board],
                method,
                plain(preset),
                str(entry.spec.seed),
                str(entry.status),
                entry.spec.budget,
                plain(command),
                entry.spec.key[:8],
                entry.spec.code.rpartition("+")[2][:8],
                commit,
                machine,
            ]
        )
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
    threads = f" ({facts['threads']} used)" if "threads" in facts else ""
    parts = [
        f"{facts['cpu']}, {facts['cores']} cores{threads}, {facts['memory_gib']} GiB",
        str(facts["os"]),
        f"Python {facts['python']}",
    ]
    if "accelerator" in facts:
        parts.append(str(facts["accelerator"]))
    return ", ".join(parts)
