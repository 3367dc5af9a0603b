"""A table of ablations as a Markdown page."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from dofbench.reporting.ablations.cells import Filled
from dofbench.reporting.ablations.row_differences import difference_cells
from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.held_out import ASKED_HEADING, asked_table
from dofbench.reporting.line_table import Beside, line_table, plain
from dofbench.reporting.markdown import commit_text, machine_text
from dofbench.reporting.paired import EXPLANATION
from dofbench.reporting.summary import Line
from dofbench.results.collecting import Entry
from dofbench.results.columns import COLUMNS
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import Source
from dofbench.running.ablation_tables import Row

_PAPER_DIGITS = 3  # of a printed SSIM
_WORDS = {True: "yes", False: "no"}


def table_page(filled: Filled, settings: Ablate) -> str:
    """The page: means, differences from the reference row, a block for every dataset, and how it was made."""
    declared, notes = filled.plan.table, Footnotes()
    page = [f"# {declared.title}", "", *([declared.note.strip(), ""] if declared.note else []), *_reading(filled), ""]
    if len(filled.datasets) > 1:
        page += [
            f"## Mean over {len(filled.datasets)} datasets",
            "",
            f"{', '.join(filled.datasets)}.",
            "",
            *_block(filled, filled.mean_lines(), notes, {row.label: row.paper for row in declared.rows}),
            "",
        ]
    page += _differences(filled, notes)
    for source in filled.plan.sources:
        figures = {row.label: _scene_figures(row, source) for row in declared.rows}
        if len(filled.datasets) == 1 and not any(figures.values()):
            figures = {row.label: row.paper for row in declared.rows}
        page += [*_heading(filled, source), "", *_block(filled, filled.lines(source.label), notes, figures), ""]
        if declared.held_out:
            page += _asked(filled, source, notes)
    page += [
        *_rows(filled),
        "",
        "## What the columns say",
        "",
        *(f"- {COLUMNS[column].label} ({column}): {COLUMNS[column].note}." for column in declared.columns),
        "",
        *_how_made(filled, settings),
    ]
    return "\n".join([*page, *notes.lines()]).rstrip() + "\n"


def _reading(filled: Filled) -> list[str]:
    """How to read the page."""
    declared = filled.plan.table
    planned = len({seed for _, _, seed in filled.plan.runs})
    seeds = f"seeds {', '.join(map(str, filled.seeds))}"
    so_far = f", of {planned} asked for" if len(filled.seeds) < planned else ""
    spread = (
        "A cell is mean ± sample standard deviation over the seeds."
        if len(filled.seeds) > 1
        else "One seed only: no spread is known, so small differences say nothing."
    )
    lines = [
        f"Measured here with {seeds}{so_far}. {spread} Bold is the best number of its column, which alone doesn't "
        "make it better: see the differences. A gap is –, with its reason; a run that failed shows how, and "
        "nothing averages over an incomplete set."
    ]
    if declared.paper_columns():
        lines += [
            "",
            f"Columns headed *paper* were not measured here: they are the figures of {declared.source}, "
            f"{declared.paper_data}. The data differ, so rows may be compared within them, "
            "not across to ours.",
        ]
    return lines


def _block(filled: Filled, lines: list[Line], notes: Footnotes, figures: dict[str, dict[str, float]]) -> list[str]:
    declared = filled.plan.table
    rows = {row.label: row for row in declared.rows}

    def switches(line: Line) -> list[str]:
        own = rows[line.method].switches
        return [plain(line.method), *(word(own[switch]) for switch in declared.switches)]

    paper = [column for column in declared.paper_columns() if any(column in given for given in figures.values())]

    def published(line: Line) -> list[str]:
        given = figures[line.method]
        return [
            f"{given[column]:.{min(COLUMNS[column].digits, _PAPER_DIGITS)}f}"
            if column in given
            else f"–{notes.mark('the paper gives no such figure')}"
            for column in paper
        ]

    return line_table(
        lines,
        declared.columns,
        notes,
        before=Beside(["row", *declared.switches], switches),
        after=Beside([f"*paper: {COLUMNS[column].heading}*" for column in paper], published),
    )


def _heading(filled: Filled, source: Source) -> list[str]:
    if filled.plan.table.held_out:
        return [f"## {source.label}, held-out focus: {source.lenses}"]
    sharp = filled.plan.table.inputs == "all-in-focus"
    trained = "trained on the sharp originals; the test views are sharp" if sharp else source.lenses
    return [f"## {source.label}", "", f"{trained[0].upper()}{trained[1:]}."]


def _asked(filled: Filled, source: Source, notes: Footnotes) -> list[str]:
    """The rows by what the test views ask for; those of which every seed has ended."""
    groups = []
    for row in filled.rows:
        seeds = [filled.entries.get((row, source.label, seed)) for seed in filled.seeds]
        if None not in seeds:
            groups.append((row, "", [entry for entry in seeds if entry is not None]))
    asked = asked_table(groups, notes)
    return [f"### {ASKED_HEADING}", "", *asked, ""] if asked else []


def word(switch: bool | str) -> str:
    """How a switch is shown."""
    return _WORDS[switch] if isinstance(switch, bool) else plain(switch)


def _scene_figures(row: Row, source: Source) -> dict[str, float]:
    """The paper's figures of the scene that the dataset was made from: fern for llff_fern or llff/fern."""
    words = set(re.split(r"[^a-z0-9]+", source.scene.lower()))
    return next((figures for scene, figures in row.paper_scenes.items() if scene.lower() in words), {})


def _differences(filled: Filled, notes: Footnotes) -> list[str]:
    reference = filled.plan.table.reference
    if reference is None:
        return []
    columns, rows = difference_cells(filled, notes)
    if not columns:
        return []
    said = (
        f"The row's score minus that of {reference}, view by view over all datasets, each of which weighs the "
        f"same; a cost is paired by dataset and seed. {EXPLANATION}"
    )
    return [
        f"## Difference from {reference}",
        "",
        said,
        "",
        *table(["row", *(COLUMNS[column].heading for column in columns)], rows, left=1),
        "",
    ]


def _rows(filled: Filled) -> list[str]:
    """What each row is: method, preset, options, and what its runs left out."""
    rows = []
    for row in filled.plan.table.rows:
        runs = [run for place, run in filled.plan.runs.items() if place[0] == row.label]
        left = {
            reason: name
            for entry in _entries(filled, row.label)
            if entry.result
            for name, reason in entry.result.left_out_stages.items()
        }
        sets = [*(f"`{key}={_json(value)}`" for key, value in row.set.items()), *(["`--force-all`"] * row.force_all)]
        rows.append(
            [
                plain(row.label),
                runs[0].spec.method,
                runs[0].spec.preset,
                " ".join(sets),
                "; ".join(f"{name}: {plain(reason)}" for reason, name in left.items()),
                plain(row.note),
            ]
        )
    heading = ["row", "method", "preset", "options set", "left out by the plan", "note"]
    return ["## What the rows are", "", *table(heading, rows, left=len(heading))]


def _how_made(filled: Filled, settings: Ablate) -> list[str]:
    entries = [entry for entry in filled.entries.values() if entry.result is not None]
    some = next(iter(filled.plan.runs.values()))
    budgets = ", ".join(dict.fromkeys(run.spec.budget for run in filled.plan.runs.values()))
    lines = [
        "## How this was made",
        "",
        f"    {settings.command()}",
        "",
        f"- Budget {budgets}, {some.spec.protocol}, device {some.spec.device}; {settings.jobs} at a time, each "
        "with its share of the machine's threads. Runs that an earlier call finished are not repeated: their "
        "training times are of then.",
    ]
    lines += [
        f"- {source.label}: {source.folder}, checksum {checksum[:16]}."
        for source, checksum in zip(filled.plan.sources, _checksums(filled), strict=True)
    ]
    for name, describe in (("Commit", commit_text), ("Machine", machine_text)):
        lines += [f"- {name} {text}." for text in dict.fromkeys(map(describe, entries))]
    lines += [f"- Code {code}." for code in dict.fromkeys(entry.spec.code for entry in entries)]
    return [*lines, "- Every run's own result.json has its command, scores per view, curve and times.", ""]


def _checksums(filled: Filled) -> Iterator[str]:
    for source in filled.plan.sources:
        yield next(run.spec.dataset_checksum for place, run in filled.plan.runs.items() if place[1] == source.label)


def _entries(filled: Filled, row: str) -> list[Entry]:
    return [entry for place, entry in filled.entries.items() if place[0] == row]


def _json(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
