"""times.csv: what every stage of every run took."""

from __future__ import annotations

from pathlib import Path

from dofbench.reporting.table_files import write_csv
from dofbench.results.collecting import Entry, board_names, variant_names

TIMES_COLUMNS = ("method", "preset", "dataset", "scene", "protocol", "seed", "within", "stage", "wall_s", "cpu_s")


def write_times_csv(path: Path, entries: tuple[Entry, ...]) -> None:
    """One row for every stage of every run, and one for every part of the training that the method times itself (within
    "train", wall time alone)."""
    names, boards = variant_names(entries), board_names(entries)
    rows: list[dict[str, object]] = []
    for entry in entries:
        if entry.result is None:
            continue
        method, preset = names[entry.variant]
        who = {
            "method": method,
            "preset": preset,
            "dataset": boards[entry.board],
            "scene": entry.scene,
            "protocol": entry.spec.protocol,
            "seed": entry.spec.seed,
        }
        rows += [
            {**who, "stage": stage, "wall_s": time.wall, "cpu_s": time.cpu}
            for stage, time in entry.result.stages.items()
        ]
        rows += [
            {**who, "within": "train", "stage": stage, "wall_s": wall}
            for stage, wall in entry.result.method_stages.items()
        ]
    write_csv(path, TIMES_COLUMNS, rows)
