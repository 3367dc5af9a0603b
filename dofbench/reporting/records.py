"""Rows of values for a CSV file: nothing rounded away, nothing laid out."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Records:
    """name: of the file. rows: column -> value; a column that a row lacks, or has None of, is empty in the file."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[dict[str, object], ...]
