"""Tables of ablations: the rows' means and differences from the reference row, as a page and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from dofbench.core.errors import InputError
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.core.files import read_json, write_json
from dofbench.evaluation.comparing.paired import EXPLANATION
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.run_spec import option_words
from dofbench.reporting.boards import Line, signs_of, united
from dofbench.reporting.paper import ssim_note
from dofbench.reporting.sections import asked_sections, column_section, commit_text, machine_text
from dofbench.reporting.tables import (
    Cell,
    Extra,
    Section,
    Table,
    cells,
    difference,
    published,
    score_headings,
    score_table,
    word_headings,
    words,
)
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import Source
from dofbench.running.ablation_scores import Filled
from dofbench.running.ablation_tables import of_scene

SCHEMA, VERSION = "dofbench.ablation", 2
_WHAT = "a table that `dofbench ablate` wrote"
_SECTION = TypeAdapter(Section)
_WORDS: dict[bool | str, str] = {True: "yes", False: "no"}


def ablation_page(filled: Filled, settings: Ablate) -> Section:
    """Means, differences from the reference row, a section for every dataset, and how it was made."""
    declared = filled.plan.table
    means: tuple[Section, ...] = ()
    if len(filled.datasets) > 1:
        title, figures = f"Mean over {len(filled.datasets)} datasets", {row.label: row.paper for row in declared.rows}
        table = _scores(filled, _lines(filled), figures, title)
        means = (Section(title, (f"{', '.join(filled.datasets)}.",), (table,)),)
    parts = (
        *means,
        *_differences(filled),
        *(_dataset(filled, source) for source in filled.plan.sources),
        _rows(filled),
        column_section(declared.columns),
        _how_made(filled, settings),
    )
    note = (declared.note.strip(),) if declared.note else ()
    return Section(declared.title, (*note, *_reading(filled)), sections=parts, id=declared.id)


def _reading(filled: Filled) -> Iterator[str]:
    """How to read the page."""
    declared, planned = filled.plan.table, len({seed for _, _, seed in filled.plan.runs})
    so_far = f", of {planned} asked for" if len(filled.seeds) < planned else ""
    spread = (
        "A cell is mean ± sample standard deviation over the seeds."
        if len(filled.seeds) > 1
        else "One seed: the spread is unknown, so small differences mean nothing."
    )
    yield (
        f"Measured here with seeds {', '.join(map(str, filled.seeds))}{so_far}. {spread} Bold is the best number of "
        "its column; whether it is significantly better, the differences show. A gap is –, with its reason; a run that "
        "failed shows how. Nothing averages over an incomplete set."
    )
    if paper := declared.paper_columns():
        yield (
            f"Columns headed *paper* were not measured here: they are the figures of {declared.source}, "
            f"{declared.paper_data}. The data differ, so compare rows within these columns, not with ours."
            f"{ssim_note(paper)}"
        )


def _scores(filled: Filled, lines: Sequence[Line], figures: Mapping[str, Mapping[str, float]], over: str) -> Table:
    """The rows with their switches and scores, followed by the paper's figures. figures: row -> score -> figure."""
    declared = filled.plan.table
    rows = {row.label: row for row in declared.rows}
    paper = [column for column in declared.paper_columns() if any(column in given for given in figures.values())]

    def switches(line: Line) -> tuple[Cell, ...]:
        own = rows[line.method].switches
        texts = (_WORDS.get(own[one], str(own[one])) for one in declared.switches)
        return cells(words(line.method, line.signs), *texts)

    def printed(line: Line) -> list[Cell]:
        silent = "the paper gives no such figure"
        return [published(figures[line.method].get(one), COLUMNS[one], silent) for one in paper]

    return score_table(
        lines,
        declared.columns,
        f"{declared.title}: {over}",
        before=Extra(word_headings("row", *declared.switches), switches),
        after=Extra(score_headings(paper, "the paper's, on other data", published=True), printed),
        group="measured here" if paper else "",
    )


def _lines(filled: Filled, dataset: str | None = None) -> list[Line]:
    """The rows on one dataset; for None as means over the datasets."""
    seeds, found = ", ".join(map(str, filled.seeds)), []
    for row in filled.rows:
        scores = {
            column: filled.mean_cell(row, column) if dataset is None else filled.cell(row, dataset, column)
            for column in filled.plan.table.columns
        }
        found.append(Line(row, "", seeds, scores, signs=_signs(filled, row, dataset)))
    return found


def _signs(filled: Filled, row: str, dataset: str | None = None) -> str:
    """The row's signs on one dataset; for None on all (`boards.NOTES`)."""
    roles = {source.label: source.role for source in filled.plan.sources}
    own = [(place[1], entry) for place, entry in filled.entries.items() if place[0] == row]
    return united(signs_of(roles[one], [entry]) for one, entry in own if dataset in (one, None))


def _dataset(filled: Filled, source: Source) -> Section:
    """The rows on one dataset. If it is the only dataset and the paper has no figures for it, the paper's means stand
    next to the rows."""
    declared = filled.plan.table
    figures = {row.label: of_scene(row.paper_scenes, source.scene) for row in declared.rows}
    if len(filled.datasets) == 1 and not any(figures.values()):
        figures = {row.label: row.paper for row in declared.rows}
    lines, sharp = _lines(filled, source.label), declared.inputs == "all-in-focus"
    scores = _scores(filled, lines, figures, source.label)
    evidence = ROLE_SAYS[source.role] + ("" if sharp else f" {PHOTOGRAPHER_SAYS[source.photographer]}")
    if declared.held_out:
        groups = [(line, runs) for line in lines if (runs := filled.runs(line.method, source.label))]
        asked, title = asked_sections(groups, source.label), f"{source.label}, held-out focus: {source.lenses}"
        return Section(title, (evidence,), (scores,), sections=asked)
    trained = "trained and tested on all-in-focus images" if sharp else source.lenses
    return Section(source.label, (f"{evidence} {trained[0].upper()}{trained[1:]}.",), (scores,))


def _differences(filled: Filled) -> Iterator[Section]:
    """Each row minus the reference row; nothing if no two rows can be compared."""
    declared, title = filled.plan.table, f"Difference from {filled.plan.table.reference}"
    found = {column: filled.differences(column) for column in declared.columns}
    columns = [column for column, rows in found.items() if any(one.difference for one in rows.values())]
    if not columns:
        return
    said = (
        f"The row's score minus that of {declared.reference}, view by view over all datasets with equal weights; a "
        f"cost is paired by dataset and seed; p of {COLUMNS[filled.tested].label}. {EXPLANATION}"
    )
    rows = tuple(
        (words(row, _signs(filled, row)), *(difference(found[column][row]) for column in columns))
        for row in found[columns[0]]
    )
    headings = (*word_headings("row"), *score_headings(columns))
    yield Section(title, (said,), (Table(f"{declared.title}: {title}", headings, rows),))


def _rows(filled: Filled) -> Section:
    """The definition of each row: method, preset, options, and the stages that its runs disabled."""
    rows = []
    for row in filled.plan.table.rows:
        run = next(run for place, run in filled.plan.runs.items() if place[0] == row.label)
        own = [entry.result for place, entry in filled.entries.items() if place[0] == row.label and entry.result]
        left = {reason: name for result in own for name, reason in result.left_out_stages.items()}
        options = (*option_words(row.set), *(("--force-all",) * row.force_all))
        disabled = "; ".join(f"{name}: {reason}" for reason, name in left.items())
        code = Cell("", sort=" ".join(options), code=options)
        rows.append(cells(row.label, run.spec.method, run.spec.preset, code, disabled, row.note))
    headings = word_headings("row", "method", "preset", "options set", "disabled by the plan", "note")
    return Section("Rows", tables=(Table(f"{filled.plan.table.title}: rows", headings, tuple(rows)),))


def _how_made(filled: Filled, settings: Ablate) -> Section:
    entries = [entry for entry in filled.entries.values() if entry.result is not None]
    results = [entry.result for entry in entries if entry.result is not None]
    specs = [run.spec for run in filled.plan.runs.values()]
    checksums = {place[1]: run.spec.dataset_checksum for place, run in filled.plan.runs.items()}
    at_a_time = settings.jobs or "one, or one a GPU,"
    lines = [
        f"Budget {', '.join(dict.fromkeys(spec.budget for spec in specs))}, {specs[0].protocol}, device "
        f"{specs[0].device}; {at_a_time} at a time, each with its share of the machine's threads. Runs that an "
        "earlier call finished are not repeated: their training times are of then.",
        *(f"{one.label}: {one.folder}, checksum {checksums[one.label][:16]}." for one in filled.plan.sources),
        *(f"Commit {text}." for text in dict.fromkeys(map(commit_text, results))),
        *(f"Machine {text}." for text in dict.fromkeys(map(machine_text, results))),
        *(f"Code {code}." for code in dict.fromkeys(entry.spec.code for entry in entries)),
        "Every run's own result.json has its command, scores per view, curve and times.",
    ]
    return Section("How this was made", command=settings.command(), items=tuple(lines))


# ---- files ----


def write_document(folder: Path, page: Section) -> Path:
    """Write `folder`/`page.id`.json atomically, for `dofbench report --ablation`, and return its path."""
    path = folder / f"{page.id}.json"
    write_json(path, {"schema_name": SCHEMA, "version": VERSION, "document": asdict(page)})
    return path


def read_documents(folder: Path) -> list[Section]:
    """All tables of a folder, by name. Raises InputError without a table, or if a file isn't one."""
    files = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not files:
        expected = "tables that `dofbench ablate` wrote; calling it again writes them without running what is finished"
        raise InputError(folder, "no *.json", expected)
    return list(map(_read, files))


def _read(file: Path) -> Section:
    data = read_json(file)
    if not isinstance(data, dict) or data.get("schema_name") != SCHEMA:
        raise InputError(file, "something else", _WHAT)
    version, document = data.get("version"), data.get("document")
    if version not in (1, VERSION):
        raise InputError(file, f"version {version!r}", f"version {VERSION}, as `dofbench ablate` writes it")
    try:
        return _SECTION.validate_python(_upgraded(document) if version == 1 else document)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise InputError(file, f"{place}: {first['msg']}", _WHAT) from None


def _upgraded(document: Any) -> Any:
    """A document of version 1, or a section in it, as version 2 has it: parts by their kind instead of one list."""
    if not isinstance(document, dict) or not isinstance(document.get("blocks"), list):
        return document
    blocks = [block for block in document["blocks"] if isinstance(block, dict)]

    def of(kind: str) -> list[dict[str, Any]]:
        found = [block for block in blocks if block.get("type") == kind]
        return [{name: value for name, value in block.items() if name != "type"} for block in found]

    return {
        "title": document.get("title"),
        "id": document.get("id", ""),
        "text": [block.get("text") for block in of("paragraph")],
        "tables": of("table"),
        "command": "".join(str(block.get("text")) for block in of("command")),
        "items": [item for block in of("items") for item in block.get("items", ())],
        "sections": list(map(_upgraded, of("section"))),
    }
