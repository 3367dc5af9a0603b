"""Tables of ablations, as `dofbench ablate` wrote them, in the page."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.reporting.ablations.ablation_page import word
from dofbench.reporting.html.layouts import not_shown, paper_number
from dofbench.reporting.html.markup import (
    Notes,
    Td,
    Th,
    gap_cell,
    score_cell,
    score_heading,
    table,
    text_cell,
)
from dofbench.reporting.paired import SIGNIFICANT
from dofbench.reporting.summary import Cell, Line, best_texts, empty_columns
from dofbench.results.columns import COLUMNS, Column
from dofbench.running.ablation_tables import read_tables, shipped_file

_SUFFIX = "-summary.csv"
_NEEDED = {
    "table",
    "row",
    "dataset",
    "seeds",
    "column",
    "mean",
    "sd",
    "status",
    "paper",
    "difference",
    "difference_sd",
    "p",
    "pairs",
}
_MEAN = "mean"  # the dataset of rows that average over all of them


@dataclass(frozen=True)
class Ablation:
    """One table. switches: row -> switch -> setting, of a table that is shipped. blocks: dataset (or "mean") -> its
    lines. paper: row -> score -> their figure. differences: row -> score -> the CSV's row."""

    id: str
    title: str
    columns: tuple[str, ...]
    switches: dict[str, dict[str, str]]
    blocks: dict[str, list[Line]]
    paper: dict[str, dict[str, float]]
    differences: dict[str, dict[str, dict[str, str]]]


def read_ablations(folder: Path) -> list[Ablation]:
    """Every `TABLE-summary.csv` of a folder. Raises InputError when there is none, or one isn't such a table."""
    files = sorted(folder.glob(f"*{_SUFFIX}")) if folder.is_dir() else []
    if not files:
        raise InputError(folder, f"no *{_SUFFIX}", "the folder of tables that `dofbench ablate` wrote")
    return [_read(file) for file in files]


def ablation_sections(ablations: list[Ablation], notes: Notes) -> str:
    """A section for each table: means, differences from the reference row, then a table for each dataset."""
    return "".join(_section(ablation, notes) for ablation in ablations)


def _read(file: Path) -> Ablation:
    try:
        with open(file, encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(file, f"nothing readable ({error})", "a table of `dofbench ablate`") from None
    if not rows or not rows[0].keys() >= _NEEDED:
        raise InputError(file, "other columns, or no row", "a table of `dofbench ablate`")
    try:
        return _parsed(file, rows)
    except ValueError as error:
        raise InputError(file, str(error), "numbers, as `dofbench ablate` writes them") from None


def _parsed(file: Path, rows: list[dict[str, str]]) -> Ablation:
    columns = tuple(dict.fromkeys(row["column"] for row in rows if row["column"] in COLUMNS))
    cells: dict[str, dict[str, dict[str, Cell]]] = {}
    seeds: dict[str, str] = {}
    paper: dict[str, dict[str, float]] = {}
    differences: dict[str, dict[str, dict[str, str]]] = {}
    for row in rows:
        if row["column"] not in COLUMNS:
            continue
        cells.setdefault(row["dataset"], {}).setdefault(row["row"], {})[row["column"]] = _summary_cell(row)
        seeds[row["row"]] = row["seeds"].replace(" ", ", ")
        if row["paper"]:
            paper.setdefault(row["row"], {})[row["column"]] = float(row["paper"])
        if row["difference"]:
            differences.setdefault(row["row"], {})[row["column"]] = row
    gap = Cell(None, reason="the table has no such cell")
    blocks = {
        dataset: [
            Line(name, "", seeds[name], {column: found.get(column, gap) for column in columns})
            for name, found in named.items()
        ]
        for dataset, named in cells.items()
    }
    table_id = file.name.removesuffix(_SUFFIX)
    return Ablation(table_id, _title(file), columns, _switches(table_id, seeds), blocks, paper, differences)


def _switches(table_id: str, rows: Iterable[str]) -> dict[str, dict[str, str]]:
    """Of the shipped table of that id; none where its rows are others by now."""
    shipped = next((one for one in read_tables(shipped_file()).tables if one.id == table_id), None)
    if shipped is None or {row.label for row in shipped.rows} != set(rows):
        return {}
    return {row.label: {name: word(row.switches[name]) for name in shipped.switches} for row in shipped.rows}


def _summary_cell(row: dict[str, str]) -> Cell:
    if row["mean"]:
        return Cell(float(row["mean"]), float(row["sd"]) if row["sd"] else None)
    if row["status"] == "no such score":
        of_all = row["dataset"] == _MEAN
        return Cell(None, reason="not every dataset has it" if of_all else "no run of this row has such a score")
    return Cell(None, failure=row["status"], reason=f"{row['row']} on {row['dataset']}: {row['status']}")


def _title(file: Path) -> str:
    """The heading of the Markdown page beside it; the file's name where there is none."""
    page = file.with_name(file.name.removesuffix(_SUFFIX) + ".md")
    first = page.read_text(encoding="utf-8").partition("\n")[0] if page.is_file() else ""
    return first.removeprefix("# ").strip() or file.name.removesuffix(_SUFFIX)


def _section(ablation: Ablation, notes: Notes) -> str:
    scenes = [dataset for dataset in ablation.blocks if dataset != _MEAN]
    # Of one dataset the mean is the same table again.
    order = [*([_MEAN] if _MEAN in ablation.blocks and len(scenes) != 1 else []), *scenes]
    parts = [_block(ablation, dataset, notes) for dataset in order]
    parts.insert(1, _differences(ablation, notes))
    return f"<section><h3>{escape(ablation.title)} <small>{escape(ablation.id)}</small></h3>{''.join(parts)}</section>"


def _block(ablation: Ablation, dataset: str, notes: Notes) -> str:
    lines = ablation.blocks[dataset]
    scenes = [name for name in ablation.blocks if name != _MEAN]
    over = f"mean over {', '.join(scenes)}" if dataset == _MEAN else dataset
    empty = empty_columns(lines, ablation.columns)
    shown = [column for column in ablation.columns if column not in empty]
    best = best_texts(lines, shown)
    means = dataset == _MEAN or len(scenes) == 1  # their figures are means too, and stand where ours are
    paper = [column for column in ablation.columns if means and any(column in row for row in ablation.paper.values())]
    switches = list(next(iter(ablation.switches.values()), {}))
    headings = [Th("row", words=True), *(Th(name, words=True) for name in switches), Th("seeds", words=True)]
    headings += [score_heading(COLUMNS[column], "measured here") for column in shown]
    headings += [score_heading(COLUMNS[column], "the paper's, on other data") for column in paper]
    rows = [
        [
            text_cell(line.method),
            *(text_cell(ablation.switches[line.method][name]) for name in switches),
            text_cell(line.seeds),
            *(score_cell(line.cells[column], COLUMNS[column], best[column], notes) for column in shown),
            *_theirs(ablation.paper.get(line.method, {}), paper, notes),
        ]
        for line in lines
    ]
    return table(headings, rows, f"{ablation.title}: {over}") + not_shown(empty)


def _theirs(printed: dict[str, float], columns: list[str], notes: Notes) -> Iterator[Td]:
    for column in columns:
        yield (
            paper_number(printed[column], COLUMNS[column])
            if column in printed
            else gap_cell("the paper has no such figure of this row", notes)
        )


def _differences(ablation: Ablation, notes: Notes) -> str:
    columns = [column for column in ablation.columns if any(column in found for found in ablation.differences.values())]
    if not columns:
        return ""
    headings = [Th("row", words=True), *(score_heading(COLUMNS[column]) for column in columns)]
    rows = [
        [text_cell(row), *(_difference(found.get(column), COLUMNS[column], notes) for column in columns)]
        for row, found in ablation.differences.items()
    ]
    caption = f"{ablation.title}: difference from the reference row, paired by dataset and seed"
    rule = f"Better or worse only where p &lt; {SIGNIFICANT:g}, adjusted for the rows of the column."
    return f'{table(headings, rows, caption)}<p class="left-out">{rule}</p>'


def _difference(row: dict[str, str] | None, column: Column, notes: Notes) -> Td:
    if row is None:
        return gap_cell("a run of the pair lacks this score", notes)
    mean = float(row["difference"])
    spread = f" ± {column.text(float(row['difference_sd']))}" if row["difference_sd"] else ""
    said = ""
    if row["p"]:
        p = float(row["p"])
        said = "p &lt; 0.001" if p < 0.001 else f"p = {p:.3f}"
        if p < SIGNIFICANT and mean != 0 and column.higher_is_better is not None:
            said += ", better" if (mean > 0) is column.higher_is_better else ", worse"
        said = f"<br><small>{said}</small>"
    return Td(f'{mean:+.{column.digits}f}<span class="spread">{spread}</span>{said}', mean, "number")
