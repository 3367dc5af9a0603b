"""What a run costs beside its training time: CPU time, cold start, and every stage's own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dofbench.errors import Status
from dofbench.reporting.collect import Entry, board_names, grouped, variant_names
from dofbench.reporting.columns import COLUMNS, Column
from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.line_table import cell_text, plain
from dofbench.reporting.summary import Cell, Line, seed_cell, spread_cell
from dofbench.reporting.tables import write_csv

COLD_START = Column("warm_up_s", "cold start", "s", None, 1,
                    "wall time of a first step before training, which compiles kernels where they aren't cached; in no "
                    "other figure")
TRAIN_CPU = Column("train_cpu_s", "training, CPU", "s", None, 1, "CPU time of training, summed over threads")
STAGE_COLUMNS = {column.id: column for column in (TRAIN_CPU, COLD_START)}
_STAGES = {COLD_START.id: ("warm up", "wall"), TRAIN_CPU.id: ("train", "cpu")}
_SHOWN = ("train_s", TRAIN_CPU.id, COLD_START.id, "peak_mb")
TIMES_COLUMNS = ("method", "preset", "dataset", "scene", "protocol", "seed", "within", "stage", "wall_s", "cpu_s")


def stage_cell(seeds: Sequence[Entry], column: str) -> Cell:
    """Seconds of a stage over the seeds; as with scores, none where a seed failed. column: of `STAGE_COLUMNS`."""
    if any(entry.status is not Status.OK for entry in seeds):
        return seed_cell(list(seeds), column)
    stage, part = _STAGES[column]
    times = [getattr(entry.result.stages[stage], part) for entry in seeds
             if entry.result is not None and stage in entry.result.stages]
    if len(times) < len(seeds):
        return Cell(None, reason=f"the result doesn't time the stage {stage!r}")
    return spread_cell(times)


def cost_lines(
    members: Sequence[Entry], names: dict[tuple[str, ...], tuple[str, str]], notes: Footnotes
) -> list[str]:
    """Wall and CPU time of training, the cold start apart, and peak memory, as a Markdown table of one board."""
    rows = []
    for variant, seeds in grouped(list(members), "variant").items():
        cells = {column: stage_cell(seeds, column) if column in STAGE_COLUMNS else seed_cell(seeds, column)
                 for column in _SHOWN}
        line = Line(*names[variant], "", cells)
        rows.append([plain(f"{line.method} {line.preset}".strip()), *(
            cell_text(line, column, None, notes, STAGE_COLUMNS.get(column) or COLUMNS[column]) for column in _SHOWN)])
    heading = ["cost", *((STAGE_COLUMNS.get(column) or COLUMNS[column]).heading for column in _SHOWN)]
    return table(heading, rows, left=1)


def write_times_csv(path: Path, entries: tuple[Entry, ...]) -> None:
    """One row for every stage of every run, and one for every part of the training that the method times itself (within
    "train", wall time alone)."""
    names, boards = variant_names(entries), board_names(entries)
    rows: list[dict[str, object]] = []
    for entry in entries:
        if entry.result is None:
            continue
        method, preset = names[entry.variant]
        who = {"method": method, "preset": preset, "dataset": boards[entry.board], "scene": entry.scene,
               "protocol": entry.spec.protocol, "seed": entry.spec.seed}
        rows += [{**who, "stage": stage, "wall_s": time.wall, "cpu_s": time.cpu}
                 for stage, time in entry.result.stages.items()]
        rows += [{**who, "within": "train", "stage": stage, "wall_s": wall}
                 for stage, wall in entry.result.method_stages.items()]
    write_csv(path, TIMES_COLUMNS, rows)
