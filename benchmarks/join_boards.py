"""Join the rows of reports into a board that was measured in several pieces.

    python benchmarks/join_boards.py reports/baselines/steps REPORT ...

Every REPORT is a folder that `dofbench report` wrote. A row of its leaderboard.csv and curves.csv takes the place of
the board's row with the same method, preset, scene, protocol and seed, and keeps that row's name of the dataset; a row
that the board lacks is added at its end. Columns are the board's; one that only a report has is an error, as joining
would lose it.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.reporting.csv_writer import write_csv

FILES = "leaderboard.csv", "curves.csv"
Row = dict[str, str]


def joined(board: list[Row], report: list[Row]) -> list[Row]:
    """The board's rows with those of the report in their places."""
    places: dict[tuple[str, ...], list[Row]] = {}
    for row in report:
        places.setdefault(run_of(row), []).append(row)
    found, done = [], set()
    for row in board:
        run = run_of(row)
        if run not in places:
            found.append(row)
        elif run not in done:  # of a curve all rows at once, as it may have another number of points
            done.add(run)
            found += [{**new, "dataset": row["dataset"]} for new in places[run]]
    return found + [row for run, rows in places.items() if run not in done for row in rows]


def run_of(row: Row) -> tuple[str, ...]:
    """What tells runs apart. The report writes a part of the checksum behind the scene where a board has two datasets
    of it; they then differ in their protocol."""
    return row["method"], row["preset"], row["dataset"].split("@")[0], row["protocol"], row["seed"]


def read(file: Path) -> tuple[list[str], list[Row]]:
    """Columns and rows. Raises InputError where there is no such file."""
    if not file.is_file():
        raise InputError(file, "no such file", "one that `dofbench report` wrote")
    with file.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        return list(reader.fieldnames or ()), list(reader)


def main(arguments: list[str]) -> int:
    """Join; prints how many rows each file has now."""
    if len(arguments) < 2:
        print("join_boards: found too few folders, expected a board and at least one report", file=sys.stderr)
        return 2
    board, *reports = (Path(folder) for folder in arguments)
    try:
        results = [(board / name, *joined_file(name, board, reports)) for name in FILES]
    except InputError as error:
        print(f"join_boards: {error}", file=sys.stderr)
        return 2
    for file, columns, rows in results:
        write_csv(file, tuple(columns), rows)
        print(f"{file}: {len(rows)} rows")
    return 0


def joined_file(name: str, board: Path, reports: list[Path]) -> tuple[list[str], list[Row]]:
    """Columns and rows of one file of the board, with those of all reports.

    Raises InputError for a report with other columns, with a run by two codes, of which one would have to be chosen, or
    with a run that ended early where the board's didn't.
    """
    columns, rows = read(board / name)
    for report in reports:
        own, new = read(report / name)
        if more := sorted(set(own) - set(columns)):
            raise InputError(report / name, f"column {more[0]}", f"a column of {board / name}")
        runs = [run_of(row) for row in new]
        if name == FILES[0] and (twice := [run for run in runs if runs.count(run) > 1]):
            raise InputError(report / name, f"{' '.join(twice[0])} twice", "every run by one code")
        ended = {run_of(row) for row in new if row.get("status", "ok") != "ok"}
        if worse := [row for row in rows if row.get("status") == "ok" and run_of(row) in ended]:
            raise InputError(report / name, f"{' '.join(run_of(worse[0]))} not ok", "ok, as the board has it")
        rows = joined(rows, [dict.fromkeys(columns, "") | row for row in new])
    return columns, rows


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
