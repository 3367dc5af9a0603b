"""The whole report: tables, curves, strips, and one page that shows them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from dofbench.core.files import write_text
from dofbench.reporting import table_files
from dofbench.reporting.comparison import write_strip
from dofbench.reporting.curves import write_curves
from dofbench.reporting.figures import file_name
from dofbench.reporting.html.html_ablations import read_ablations
from dofbench.reporting.html.html_page import report_page
from dofbench.reporting.markdown import leaderboard_markdown
from dofbench.reporting.pairwise import board_pairs, write_comparisons_csv
from dofbench.reporting.plots import Plot, make_plots
from dofbench.reporting.reach import RULE
from dofbench.reporting.report_options import Report
from dofbench.reporting.times import write_times_csv
from dofbench.reporting.timing import (
    FRONT_RULE,
    TIME_RULE,
    level_words,
    timing_lines,
    write_front_csv,
    write_reach_csv,
)
from dofbench.results.collecting import board_names, collect, grouped, variant_names


@dataclass(frozen=True)
class Written:
    """files: what was written, in order. unreadable: one line for each result that was skipped.
    Iterates over the files; true when every result could be read."""

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
    named. Raises InputError when there is no result at all, or no table in a folder of ablations.
    """
    console = console or Console()
    collection = collect(settings.results)
    entries, out = collection.entries, settings.out
    ablations = read_ablations(settings.ablation) if settings.ablation is not None else []

    def say(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    for problem in collection.unreadable:
        say(f"skipped: {problem}")
    for folder in collection.running:
        say(f"not counted, a run is at work there: {folder}")

    for folder in collection.doubles:
        say(f"not counted, a copy of another result: {folder}")

    names, boards = variant_names(entries), board_names(entries)
    plots = make_plots(entries, names, boards, settings.levels)
    files = [
        out / name
        for name in (
            "leaderboard.csv",
            "per_view.csv",
            "curves.csv",
            "comparisons.csv",
            "reach.csv",
            "pareto.csv",
            "times.csv",
        )
    ]
    table_files.write_leaderboard_csv(files[0], entries)
    table_files.write_per_view_csv(files[1], entries)
    table_files.write_curves_csv(files[2], entries)
    write_reach_csv(files[4], plots)
    write_front_csv(files[5], plots)
    write_times_csv(files[6], entries)

    pairs = [(boards[board], board[2], board_pairs(own)) for board, own in grouped(entries, "board").items()]
    write_comparisons_csv(files[3], pairs, names)
    drawn = write_curves(out / "curves", plots)
    blocks: dict[tuple[str, ...], list[str]] = {}
    for board, members in grouped(entries, "board").items():
        figures = drawn.get(board, {})
        files += [path for paths in figures.values() for path in paths]
        strip = None
        if settings.pictures:
            strip = out / "comparison" / f"{file_name(boards[board], board[2])}.png"
            trouble = write_strip(strip, members, names)
            if trouble is None:
                files.append(strip)
            else:
                strip = None
                say(f"no pictures of {boards[board]}, {board[2]}: {trouble}")
        own = [plot for plot in plots if plot.board == board]
        rules = "" if blocks else f"{TIME_RULE}. {RULE} {level_words(plots)} {FRONT_RULE}."  # said once
        blocks[board] = _block(own, figures, strip, rules)
    page = out / "leaderboard.md"
    write_text(page, leaderboard_markdown(collection, blocks))
    files.append(page)
    whole = out / "report.html"
    write_text(whole, report_page(collection, plots, ablations, pictures=settings.pictures))
    files.append(whole)
    for file in files:
        say(f"wrote {file}")
    return Written(tuple(files), collection.unreadable)


def _block(
    plots: list[Plot],
    figures: dict[str, list[Path]],
    strip: Path | None,
    rules: str,
) -> list[str]:
    """What stands below the tables of one board: error against run time, and pictures."""
    lines = ["### Error against run time", "", *([rules, ""] if rules else [])]
    for plot in plots:
        if (paths := figures.get(plot.column)) is not None:
            lines += [f"![{plot.score.label} against training time](curves/{paths[0].name})", ""]
        lines += timing_lines(plot)
    if strip is not None:
        lines += [f"![truth, predictions and errors](comparison/{strip.name})", ""]
    return lines
