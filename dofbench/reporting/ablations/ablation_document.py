"""A table of ablations as a page of its own: means, differences from the reference row, and how it was made."""

from __future__ import annotations

from collections.abc import Iterator

from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.run_spec import option_words
from dofbench.reporting import standing, table_cells
from dofbench.reporting.ablations.filled_table import Filled
from dofbench.reporting.ablations.row_differences import differences
from dofbench.reporting.held_out import asked_section
from dofbench.reporting.how_made import commit_text, machine_text
from dofbench.reporting.leaderboard import column_section
from dofbench.reporting.paired import EXPLANATION
from dofbench.reporting.paper import OF_THEIR_SSIM, names_their_ssim, of_scene
from dofbench.reporting.score_table import Beside, score_table
from dofbench.reporting.summary import Line
from dofbench.reporting.view import Block, Cell, Command, Document, Items, Paragraph, Section, Table
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import Source

_WORDS = {True: "yes", False: "no"}


def ablation_document(filled: Filled, settings: Ablate) -> Document:
    """The page: means, differences from the reference row, a section for every dataset, and how it was made."""
    declared = filled.plan.table
    blocks: list[Block] = [Paragraph(declared.note.strip())] if declared.note else []
    blocks += _reading(filled)
    if len(filled.datasets) > 1:
        figures = {row.label: row.paper for row in declared.rows}
        title = f"Mean over {len(filled.datasets)} datasets"
        over = Paragraph(f"{', '.join(filled.datasets)}.")
        blocks.append(Section(title, (over, _scores(filled, filled.mean_lines(), figures, title))))
    blocks += _differences(filled)
    blocks += [_dataset(filled, source) for source in filled.plan.sources]
    blocks += [_rows(filled), column_section(declared.columns), _how_made(filled, settings)]
    return Document(declared.id, declared.title, tuple(blocks))


def _reading(filled: Filled) -> Iterator[Paragraph]:
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
    yield Paragraph(
        f"Measured here with {seeds}{so_far}. {spread} Bold is the best number of its column, which alone doesn't "
        "make it better: see the differences. A gap is –, with its reason; a run that failed shows how, and "
        "nothing averages over an incomplete set."
    )
    if paper := declared.paper_columns():
        of_ssim = f" {OF_THEIR_SSIM}" if names_their_ssim(paper) else ""
        yield Paragraph(
            f"Columns headed *paper* were not measured here: they are the figures of {declared.source}, "
            f"{declared.paper_data}. The data differ, so rows may be compared within them, "
            f"not across to ours.{of_ssim}"
        )


def _scores(filled: Filled, lines: list[Line], figures: dict[str, dict[str, float]], over: str) -> Table:
    """The rows with their switches and scores, followed by the paper's figures. figures: row -> score -> figure."""
    declared = filled.plan.table
    rows = {row.label: row for row in declared.rows}
    paper = [column for column in declared.paper_columns() if any(column in given for given in figures.values())]

    def switches(line: Line) -> list[Cell]:
        own = rows[line.method].switches
        named = table_cells.words(line.method, line.signs)
        return [named, *(table_cells.words(_word(own[one])) for one in declared.switches)]

    def published(line: Line) -> list[Cell]:
        silent = "the paper gives no such figure"
        return [table_cells.published(figures[line.method].get(one), COLUMNS[one], silent) for one in paper]

    return score_table(
        lines,
        declared.columns,
        f"{declared.title}: {over}",
        before=Beside(table_cells.word_headings("row", *declared.switches), switches),
        after=Beside(
            tuple(
                table_cells.score_heading(COLUMNS[one], "the paper's, on other data", published=True) for one in paper
            ),
            published,
        ),
        group="measured here" if paper else "",
    )


def _dataset(filled: Filled, source: Source) -> Section:
    """The rows on one dataset. If it is the only dataset and the paper has no figures for it, the paper's means stand
    beside the rows."""
    declared = filled.plan.table
    figures = {row.label: of_scene(row.paper_scenes, source.scene) for row in declared.rows}
    if len(filled.datasets) == 1 and not any(figures.values()):
        figures = {row.label: row.paper for row in declared.rows}
    scores = _scores(filled, filled.lines(source.label), figures, source.label)
    sharp = declared.inputs == "all-in-focus"
    evidence = ROLE_SAYS[source.role] if sharp else f"{ROLE_SAYS[source.role]} {PHOTOGRAPHER_SAYS[source.photographer]}"
    if declared.held_out:
        groups = [
            (line, runs) for line in filled.lines(source.label) if (runs := filled.runs(line.method, source.label))
        ]
        asked = asked_section(groups, source.label)
        return Section(
            f"{source.label}, held-out focus: {source.lenses}",
            (Paragraph(evidence), scores, *((asked,) if asked is not None else ())),
        )
    trained = "trained on the sharp originals; the test views are sharp" if sharp else source.lenses
    return Section(source.label, (Paragraph(f"{evidence} {trained[0].upper()}{trained[1:]}."), scores))


def _word(switch: bool | str) -> str:
    """The text that shows a switch's value."""
    return _WORDS[switch] if isinstance(switch, bool) else switch


def _differences(filled: Filled) -> Iterator[Section]:
    """Section with each row minus the reference row; none if no two rows can be compared."""
    reference = filled.plan.table.reference
    if reference is None:
        return
    found = {column: differences(filled, column) for column in filled.plan.table.columns}
    columns = [column for column, rows in found.items() if any(one.difference for one in rows.values())]
    if not columns:
        return
    said = (
        f"The row's score minus that of {reference}, view by view over all datasets, each of which weighs the "
        f"same; a cost is paired by dataset and seed. {EXPLANATION}"
    )
    title = f"Difference from {reference}"
    headings = (*table_cells.word_headings("row"), *(table_cells.score_heading(COLUMNS[column]) for column in columns))
    rows = tuple(
        (
            table_cells.words(row, filled.signs(row, filled.datasets)),
            *(table_cells.difference(found[column][row]) for column in columns),
        )
        for row in filled.rows
        if row != reference
    )
    below = standing.notes(filled.signs(row, filled.datasets) for row in filled.rows)
    yield Section(title, (Paragraph(said), Table(f"{filled.plan.table.title}: {title}", headings, rows, below=below)))


def _rows(filled: Filled) -> Section:
    """Section that defines each row: method, preset, options, and the stages that its runs left out."""
    rows = []
    for row in filled.plan.table.rows:
        runs = [run for place, run in filled.plan.runs.items() if place[0] == row.label]
        left = {
            reason: name
            for entry in _entries(filled, row.label)
            if entry.result
            for name, reason in entry.result.left_out_stages.items()
        }
        options = (*option_words(row.set), *(("--force-all",) * row.force_all))
        rows.append(
            (
                *(table_cells.words(text) for text in (row.label, runs[0].spec.method, runs[0].spec.preset)),
                Cell("", sort=" ".join(options), code=options),
                table_cells.words("; ".join(f"{name}: {reason}" for reason, name in left.items())),
                table_cells.words(row.note),
            )
        )
    headings = table_cells.word_headings("row", "method", "preset", "options set", "left out by the plan", "note")
    title = "What the rows are"
    return Section(title, (Table(f"{filled.plan.table.title}: {title}", headings, tuple(rows)),))


def _how_made(filled: Filled, settings: Ablate) -> Section:
    entries = [entry for entry in filled.entries.values() if entry.result is not None]
    results = [entry.result for entry in entries if entry.result is not None]
    some = next(iter(filled.plan.runs.values()))
    budgets = ", ".join(dict.fromkeys(run.spec.budget for run in filled.plan.runs.values()))
    lines = [
        f"Budget {budgets}, {some.spec.protocol}, device {some.spec.device}; {settings.jobs} at a time, each "
        "with its share of the machine's threads. Runs that an earlier call finished are not repeated: their "
        "training times are of then."
    ]
    lines += [
        f"{source.label}: {source.folder}, checksum {checksum[:16]}."
        for source, checksum in zip(filled.plan.sources, _checksums(filled), strict=True)
    ]
    for name, describe in (("Commit", commit_text), ("Machine", machine_text)):
        lines += [f"{name} {text}." for text in dict.fromkeys(map(describe, results))]
    lines += [f"Code {code}." for code in dict.fromkeys(entry.spec.code for entry in entries)]
    lines.append("Every run's own result.json has its command, scores per view, curve and times.")
    return Section("How this was made", (Command(settings.command()), Items(tuple(lines))))


def _checksums(filled: Filled) -> Iterator[str]:
    for source in filled.plan.sources:
        yield next(run.spec.dataset_checksum for place, run in filled.plan.runs.items() if place[1] == source.label)


def _entries(filled: Filled, row: str) -> list[Entry]:
    return [entry for place, entry in filled.entries.items() if place[0] == row]
