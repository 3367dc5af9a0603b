"""Records as CSV files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path

from dofbench.core.files import write_text
from dofbench.reporting.records import Records


def write_records(folder: Path, records: Records) -> Path:
    """Write `folder`/`records.name` atomically and return its path."""
    path = folder / records.name
    write_csv(path, records.columns, records.rows)
    return path


def write_csv(path: Path, columns: tuple[str, ...], rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows, column -> value, atomically; a column that a row lacks is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_cell(row.get(column)) for column in columns])
    write_text(path, stream.getvalue())


def _cell(value: object) -> object:
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else f"{value:.8g}"
    return "" if value is None else value
