"""Writes the whole report: reads the results, draws figures, builds the page's data, and renders the templates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.core.files import write_csv, write_text
from dofbench.core.progress import say
from dofbench.evaluation.comparing.pairwise import pairwise
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.results.collecting import Entry, added_columns, board_names, collect, grouped, variant_names
from dofbench.evaluation.results.columns import FILE_SCORES, IDENTITY, PER_VIEW, STANDING
from dofbench.reporting.ablation import read_documents
from dofbench.reporting.boards import gather, role_of
from dofbench.reporting.curves import board_plots, mean_plots
from dofbench.reporting.draw import write_curves, write_strip
from dofbench.reporting.installed import frozen_state, read_again
from dofbench.reporting.pairs import comparison_rows, mean_pairs
from dofbench.reporting.pictures import galleries, link
from dofbench.reporting.render import html, markdown
from dofbench.reporting.report_options import Report
from dofbench.reporting.timing import curve_view, front_rows, reach_rows
from dofbench.reporting.view import build_view, page_data

Row = dict[str, object]

PAGES = {"report": "Pictures and tables", "curves": "Error against time", "scores": "Every score", "runs": "Runs"}
CURVE_COLUMNS = """method preset dataset protocol seed train_s steps psnr ssim aif_psnr aif_ssim delta_a delta_f delta_r
    loss train_cpu_s photo_psnr photo_ssim across_psnr across_ssim role""".split()
COMPARISON_COLUMNS = """dataset protocol method preset against_method against_preset column pairs seeds difference low
    high p verdict reason role groups above below spread""".split()
REACH_COLUMNS = """method preset dataset scene protocol seed score level reached_s not_before_s held status
    role clock""".split()
FRONT_COLUMNS = "dataset protocol score train_s value method preset role clock".split()
TIMES_COLUMNS = "method preset dataset scene protocol seed within stage wall_s cpu_s role".split()


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
    comparison/, leaderboard.md, the pages of `PAGES` and their pictures/.

    The same results give the same files, byte for byte. A result that can't be read is skipped and named. Raises
    InputError when there is no result at all or none of a method to compare with, or no table in a folder of ablations.
    """
    read_again()
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
    tables: dict[str, tuple[Sequence[str], Iterator[Row]]] = {
        "leaderboard": (run_columns(entries), run_rows(entries)),
        "per_view": (view_columns(entries), view_rows(entries)),
        "curves": (CURVE_COLUMNS, curve_rows(entries)),
        "comparisons": (COMPARISON_COLUMNS, comparison_rows(boards, pairs, of_means, names)),
        "reach": (REACH_COLUMNS, reach_rows(plots)),
        "pareto": (FRONT_COLUMNS, front_rows((*plots, *means))),
        "times": (TIMES_COLUMNS, time_rows(entries)),
    }
    files = [out / f"{name}.csv" for name in tables]
    for file, (columns, rows) in zip(files, tables.values(), strict=True):
        write_csv(file, columns, rows)

    drawn = write_curves(out / "curves", (*means, *plots))
    files += [file for paths in drawn.values() for file in paths]
    pictures = []
    if settings.pictures:
        if settings.refocus:
            tell(f"refocus frames, of up to {settings.refocus} models; missing ones are rendered")
        pictures = galleries(boards, settings.refocus)
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
    files.append(out / "leaderboard.md")
    write_text(files[-1], markdown("leaderboard", view=view))
    linked = link((file for board in pictures for file in board.files), out / "pictures")
    pages = {name: title for name, title in PAGES.items() if name != "curves" or view.curves}
    for name in reversed(pages):
        files.append(out / f"{name}.html")
        write_text(files[-1], html(name, view=view, files=linked, pages=pages, **page_data(view)))
    tell(f"wrote {len(files)} files to {out}")
    tell(f"open {files[-1]}")
    return Written(tuple(files), collection.unreadable)


def _linked(files: Sequence[Path] | None) -> str:
    """The first file's place in the report's folder; "" without one."""
    return f"{files[0].parent.name}/{files[0].name}" if files else ""


# ---- CSV files: every number of every run, without averages and unrounded ----


def run_columns(entries: Sequence[Entry]) -> tuple[str, ...]:
    """The columns of `run_rows`."""
    return (*IDENTITY, *FILE_SCORES, *added_columns(entries), *STANDING)


def run_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row per run. A cell is empty when the run lacks the score; the pages give the reason."""
    for entry, who in _identified(entries):
        yield {**who, **entry.scores, "frozen": frozen_state(entry)}


def view_columns(entries: Sequence[Entry]) -> tuple[str, ...]:
    """The columns of `view_rows`."""
    return (*PER_VIEW, *added_columns(entries), "role")


def view_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every test view (its scores) and every training view (its lens and the errors)."""
    for entry, who in _identified(entries):
        if entry.result is not None:
            yield from ({**who, "view": view, "split": "test", **scores} for view, scores in entry.views.items())
            for lens in entry.result.lens:
                yield {**who, "split": "train", **lens.model_dump(exclude={"name"}), "view": lens.name}


def curve_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every moment of training that was scored."""
    for entry, who in _identified(entries):
        for point in entry.result.curve if entry.result else ():
            times = {name: getattr(point, name) for name in ("train_s", "steps", "loss", "train_cpu_s")}
            yield {**who, **point.scores, **times}


def time_rows(entries: Sequence[Entry]) -> Iterator[Row]:
    """One row for every stage of every run, and for every part of training that the method times itself (within
    "train", wall time alone)."""
    names = variant_names(tuple(entries))
    for entry, who in _identified(entries):
        if entry.result is not None:
            who["preset"] = names[entry.variant][1]
            for stage, time in entry.result.stages.items():
                yield {**who, "stage": stage, "wall_s": time.wall, "cpu_s": time.cpu}
            for stage, wall in entry.result.method_stages.items():
                yield {**who, "within": "train", "stage": stage, "wall_s": wall}


def _identified(entries: Sequence[Entry]) -> Iterator[tuple[Entry, Row]]:
    """Each run with its identity columns. A dataset's name has its checksum if two datasets have the same name."""
    boards = board_names(tuple(entries))
    roles = {board: role_of(members) for board, members in grouped(tuple(entries), "board").items()}
    for entry in entries:
        yield (
            entry,
            {
                "method": entry.spec.method,
                "preset": entry.preset,
                "dataset": boards[entry.board],
                "scene": entry.scene,
                "protocol": entry.spec.protocol,
                "seed": entry.spec.seed,
                "status": str(entry.status),
                "role": roles[entry.board] or ROLE_NOT_STATED,
                "photographer": entry.result.photographer if entry.result else None,
            },
        )
