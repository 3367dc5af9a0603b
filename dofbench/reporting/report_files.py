"""Writes the whole report: reads the results, writes the CSV files, draws figures, and writes the pages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.files import write_csv
from dofbench.core.progress import say
from dofbench.evaluation.comparing.pairwise import pairwise
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.results.collecting import collect, variant_names
from dofbench.methods.cards import read_once
from dofbench.reporting import csv_tables
from dofbench.reporting.ablation import read_documents
from dofbench.reporting.boards import Board, Variant, gather
from dofbench.reporting.curves import Plot, board_plots, mean_plots
from dofbench.reporting.draw import write_curves, write_strip
from dofbench.reporting.pages import Content, datasets, write_by_scene, write_together
from dofbench.reporting.pairs import comparison_rows, mean_pairs
from dofbench.reporting.pictures import BoardPictures, galleries
from dofbench.reporting.report_options import Report
from dofbench.reporting.timing import curve_view, front_rows, reach_rows

MOST_CURVES = 100  # series of one plot


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


@read_once()
def write_report(settings: Report, console: Console | None = None) -> Written:
    """Write leaderboard.csv, per_view.csv, curves.csv, comparisons.csv, reach.csv, pareto.csv, times.csv, runs.csv,
    curves/, leaderboard.md, the pages of `pages.PAGES` and their pictures/, and of a small report comparison/; of a
    large one (`Report.page_runs`) a set of pages for each dataset in scenes/.

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
    order: dict[Variant, int] = {entry.board: number for number, entry in enumerate(entries)}  # of the CSV files
    plots = board_plots(sorted(boards, key=lambda board: order[board.key]), names, settings.levels)
    means = mean_plots(boards, plots, settings.levels)
    pairs = {board.key: pairwise([board.variants], settings.rivals) for board in boards}
    of_means = mean_pairs(boards, settings.rivals)
    tables: dict[str, tuple[Sequence[str], Iterator[csv_tables.Row]]] = {
        **csv_tables.run_tables(entries),
        "comparisons": (csv_tables.COMPARISON_COLUMNS, comparison_rows(boards, pairs, of_means, names)),
        "reach": (csv_tables.REACH_COLUMNS, reach_rows(plots)),
        "pareto": (csv_tables.FRONT_COLUMNS, front_rows((*plots, *means))),
    }
    files = [out / f"{name}.csv" for name in tables]
    for file, (columns, rows) in zip(files, tables.values(), strict=True):
        write_csv(file, columns, rows)

    large = len(entries) > settings.page_runs and datasets(boards) > 1
    shown, of_scenes = ([plot.best(MOST_CURVES) for plot in some] for some in (means, plots))
    drawn = write_curves(out / "curves", shown if large else (*shown, *of_scenes))
    files += [file for paths in drawn.values() for file in paths]

    def picture(plot: Plot) -> str:
        return _linked(drawn.get((plot.board, plot.column)))

    if settings.pictures and settings.refocus:
        tell(f"refocus frames, of up to {settings.refocus} models; missing ones are rendered")
    content = Content(
        collection,
        boards,
        names,
        curves=[curve_view(plot, picture(plot)) for plot in of_scenes],
        means=[curve_view(plot, picture(plot)) for plot in shown],
        pairs=pairs,
        of_means=of_means,
        ablations=ablations,
        most=settings.page_runs,
    )
    if large:
        tell(f"{len(entries)} runs, more than --page-runs: each dataset has pages of its own, and no drawn figures")
        files += write_by_scene(out, content, pictures=settings.pictures, refocus=settings.refocus)
    else:
        gallery = galleries(boards, settings.refocus) if settings.pictures else []
        strips = _strips(out, boards, gallery, tell)
        files += strips.values()
        files += write_together(out, content, gallery, {board: _linked([strip]) for board, strip in strips.items()})
    tell(f"wrote {len(files)} files to {out}")
    tell(f"open {files[-1]}")
    return Written(tuple(files), collection.unreadable)


def _strips(
    out: Path, boards: Sequence[Board], gallery: Sequence[BoardPictures], tell: partial[None]
) -> dict[Variant, Path]:
    """Board -> the strip of its pictures, where there are some."""
    strips = {}
    for board, shown in zip(boards, gallery, strict=False):
        strip = out / "comparison" / f"{file_name(board.name, board.protocol)}.png"
        trouble = write_strip(strip, shown)
        if trouble is None:
            strips[board.key] = strip
        else:
            tell(f"no pictures of {board.name}, {board.protocol}: {trouble}")
    return strips


def _linked(files: Sequence[Path] | None) -> str:
    """The first file's place in the report's folder; "" without one."""
    return f"{files[0].parent.name}/{files[0].name}" if files else ""
