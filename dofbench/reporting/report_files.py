"""Writes the whole report: reads the results, draws figures, builds the page's data, and renders the templates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.files import write_csv, write_text
from dofbench.core.progress import say
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.results.collecting import collect, variant_names
from dofbench.reporting import csv_files
from dofbench.reporting.ablation import read_documents
from dofbench.reporting.boards import gather
from dofbench.reporting.curves import board_plots, mean_plots
from dofbench.reporting.draw import write_curves, write_strip
from dofbench.reporting.pairs import comparison_rows, mean_pairs, pairwise
from dofbench.reporting.pictures import gallery
from dofbench.reporting.render import html, markdown
from dofbench.reporting.report_options import Report
from dofbench.reporting.timing import curve_view, front_rows, reach_rows
from dofbench.reporting.view import build_view, page_data


@dataclass(frozen=True)
class Written:
    """The outcome of `write_report`. files: the files written, in order. unreadable: one line for each result that was
    skipped. Iterates over the files; true when every result could be read."""

    files: tuple[Path, ...]
    unreadable: tuple[str, ...]

    def __iter__(self) -> Iterator[Path]:
        return iter(self.files)

    def __bool__(self) -> bool:
        return not self.unreadable


def write_report(settings: Report, console: Console | None = None) -> Written:
    """Write leaderboard.csv, per_view.csv, curves.csv, comparisons.csv, reach.csv, pareto.csv, times.csv, curves/,
    comparison/, leaderboard.md and report.html.

    The same results give the same files, byte for byte. A result that can't be read is skipped and named. Raises
    InputError when there is no result at all or none of a method to compare with, or no table in a folder of ablations.
    """
    tell = partial(say, console or Console())
    collection, out = collect(settings.results, *settings.merge), settings.out
    ablations = read_documents(settings.ablation) if settings.ablation is not None else ()
    for said, places in (
        ("skipped", collection.unreadable),
        ("not counted, a run is at work there", collection.running),
        ("not counted, a copy of another result", collection.doubles),
    ):
        for place in places:
            tell(f"{said}: {place}")
    entries = collection.entries
    there = sorted({entry.spec.method for entry in entries})
    for method in settings.rivals:
        if method not in there:
            raise InputError("--against", repr(method), f"methods with results here: {', '.join(there)}")

    boards, names = gather(entries), variant_names(entries)
    order: list[tuple[str, ...]] = [entry.board for entry in entries]  # of the CSV files
    plots = board_plots(sorted(boards, key=lambda board: order.index(board.key)), names, settings.levels)
    means = mean_plots(boards, plots, settings.levels)
    pairs = {board.key: pairwise([board.variants], settings.rivals) for board in boards}
    of_means = mean_pairs(boards, settings.rivals)
    tables: dict[str, tuple[Sequence[str], Iterator[csv_files.Row]]] = {
        "leaderboard": (csv_files.run_columns(entries), csv_files.run_rows(entries)),
        "per_view": (csv_files.view_columns(entries), csv_files.view_rows(entries)),
        "curves": (csv_files.CURVE_COLUMNS, csv_files.curve_rows(entries)),
        "comparisons": (csv_files.COMPARISON_COLUMNS, comparison_rows(boards, pairs, of_means, names)),
        "reach": (csv_files.REACH_COLUMNS, reach_rows(plots)),
        "pareto": (csv_files.FRONT_COLUMNS, front_rows((*plots, *means))),
        "times": (csv_files.TIMES_COLUMNS, csv_files.time_rows(entries)),
    }
    files = [out / f"{name}.csv" for name in tables]
    for file, (columns, rows) in zip(files, tables.values(), strict=True):
        write_csv(file, columns, rows)

    drawn = write_curves(out / "curves", (*means, *plots))
    files += [file for paths in drawn.values() for file in paths]
    pictures = [gallery(board) for board in boards] if settings.pictures else []
    strips = {}
    for board, shown in zip(boards, pictures, strict=False):
        strip = out / "comparison" / f"{file_name(board.name, board.protocol)}.png"
        trouble = write_strip(strip, shown)
        if trouble is None:
            strips[board.key] = strip
        else:
            tell(f"no pictures of {board.name}, {board.protocol}: {trouble}")
    files += strips.values()
    view = build_view(
        collection,
        boards,
        curves=[curve_view(plot, _linked(drawn.get((plot.board, plot.column)))) for plot in plots],
        mean_curves=[curve_view(plot, _linked(drawn.get((plot.board, plot.column)))) for plot in means],
        pairs=pairs,
        of_means=of_means,
        strips={board: _linked([strip]) for board, strip in strips.items()},
        gallery=pictures,
        ablations=ablations,
    )
    files += [out / "leaderboard.md", out / "report.html"]
    write_text(files[-2], markdown("leaderboard.md", view=view))
    write_text(files[-1], html("report.html", view=view, **page_data(view)))
    for file in files:
        tell(f"wrote {file}")
    return Written(tuple(files), collection.unreadable)


def _linked(files: Sequence[Path] | None) -> str:
    """The first file's place in the report's folder; "" without one."""
    return f"{files[0].parent.name}/{files[0].name}" if files else ""
