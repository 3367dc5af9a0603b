"""The whole report: tables, curves, strips, and one page that shows them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from dofbench.files import write_text
from dofbench.reporting import tables
from dofbench.reporting.collect import board_names, collect, grouped, variant_names
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.comparison import write_strip
from dofbench.reporting.curves import write_curves
from dofbench.reporting.figures import file_name
from dofbench.reporting.markdown import leaderboard_markdown
from dofbench.reporting.pairwise import board_pairs, write_comparisons_csv
from dofbench.reporting.settings import Report


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
    """Write leaderboard.csv, per_view.csv, curves.csv, comparisons.csv, curves/, comparison/ and leaderboard.md.

    The same results give the same files, byte for byte. A result that can't be read is skipped and
    named. Raises InputError when there is no result at all.
    """
    console = console or Console()
    collection = collect(settings.results)
    entries, out = collection.entries, settings.out

    def say(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    for problem in collection.unreadable:
        say(f"skipped: {problem}")
    for folder in collection.running:
        say(f"not counted, a run is at work there: {folder}")

    for folder in collection.doubles:
        say(f"not counted, a copy of another result: {folder}")

    files = [out / name for name in ("leaderboard.csv", "per_view.csv", "curves.csv", "comparisons.csv")]
    tables.write_leaderboard_csv(files[0], entries)
    tables.write_per_view_csv(files[1], entries)
    tables.write_curves_csv(files[2], entries)

    pictures: dict[tuple[str, ...], list[tuple[str, str]]] = {}
    names, boards = variant_names(entries), board_names(entries)
    pairs = [(boards[board], board[2], board_pairs(own)) for board, own in grouped(entries, "board").items()]
    write_comparisons_csv(files[3], pairs, names)
    for board, members in grouped(entries, "board").items():
        name = boards[board]
        shown = pictures.setdefault(board, [])
        for column, paths in write_curves(out / "curves", members, name, names).items():
            files += paths
            shown.append((f"{COLUMNS[column].label} against training time", f"curves/{paths[0].name}"))
        if not settings.pictures:
            continue
        strip = out / "comparison" / f"{file_name(name, board[2])}.png"
        trouble = write_strip(strip, members, names)
        if trouble is None:
            files.append(strip)
            shown.append(("truth, predictions and errors", f"comparison/{strip.name}"))
        else:
            say(f"no pictures of {name}, {board[2]}: {trouble}")
    page = out / "leaderboard.md"
    write_text(page, leaderboard_markdown(collection, pictures))
    files.append(page)
    for file in files:
        say(f"wrote {file}")
    return Written(tuple(files), collection.unreadable)
