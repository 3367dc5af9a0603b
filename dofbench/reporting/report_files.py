"""Writes the whole report: reads the results, draws plots, builds the report's data, and calls the writers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.files import write_text
from dofbench.core.progress import say
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.results.collecting import board_names, collect, variant_names
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.reporting.ablations.document_files import read_documents
from dofbench.reporting.boards import Board, gather
from dofbench.reporting.build_report import Key, build_report
from dofbench.reporting.comparison import write_strip
from dofbench.reporting.csv_writer import write_records
from dofbench.reporting.curves import write_curves
from dofbench.reporting.gallery import BoardPictures, gallery
from dofbench.reporting.html.html_page import report_page
from dofbench.reporting.markdown_report import leaderboard_markdown
from dofbench.reporting.plots import make_plots, mean_plots
from dofbench.reporting.report_options import Report
from dofbench.reporting.view import Picture


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

    The same results give the same files, byte for byte. A result that can't be read is skipped and
    named. Raises InputError when there is no result at all or none of a method to compare with, or no table
    in a folder of ablations.
    """
    console = console or Console()
    collection, out = collect(settings.results, *settings.merge), settings.out
    ablations = read_documents(settings.ablation) if settings.ablation is not None else ()

    tell = partial(say, console)

    for problem in collection.unreadable:
        tell(f"skipped: {problem}")
    for folder in collection.running:
        tell(f"not counted, a run is at work there: {folder}")
    for folder in collection.doubles:
        tell(f"not counted, a copy of another result: {folder}")

    entries = collection.entries
    there = sorted({entry.spec.method for entry in entries})
    for method in settings.rivals:
        if method not in there:
            raise InputError("--against", repr(method), f"methods with results here: {', '.join(there)}")
    boards = gather(entries)
    plots = make_plots(entries, variant_names(entries), board_names(entries), settings.levels)
    pictures = gallery(boards) if settings.pictures else None
    means = mean_plots(boards, plots, settings.levels)
    drawn = write_curves(out / "curves", (*means, *plots))
    strips = _strips(out, boards, pictures, tell) if pictures is not None else {}
    view = build_report(
        collection,
        boards,
        plots,
        means=means,
        drawn={
            (board, column): Picture(f"curves/{files[0].name}", f"{COLUMNS[column].label} against training time")
            for (board, column), files in drawn.items()
        },
        strips={
            board: Picture(f"comparison/{strip.name}", "truth, predictions and errors")
            for board, strip in strips.items()
        },
        against=settings.rivals,
        ablations=ablations,
        pictures=pictures,
    )
    files = [write_records(out, records) for records in view.records]
    files += [file for paths in drawn.values() for file in paths]
    files += strips.values()
    for name, text in (("leaderboard.md", leaderboard_markdown(view)), ("report.html", report_page(view))):
        write_text(out / name, text)
        files.append(out / name)
    for file in files:
        tell(f"wrote {file}")
    return Written(tuple(files), collection.unreadable)


def _strips(
    out: Path, boards: Sequence[Board], pictures: Sequence[BoardPictures], tell: Callable[[str], None]
) -> dict[Key, Path]:
    """Board -> its strip of pictures. A strip that can't be made is reported through `say`."""
    strips = {}
    for board, shown in zip(boards, pictures, strict=True):
        strip = out / "comparison" / f"{file_name(board.name, board.protocol)}.png"
        trouble = write_strip(strip, shown)
        if trouble is None:
            strips[board.key] = strip
        else:
            tell(f"no pictures of {board.name}, {board.protocol}: {trouble}")
    return strips
