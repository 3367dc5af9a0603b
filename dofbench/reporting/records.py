"""Rows of values for a CSV file, neither rounded nor formatted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Records:
    """The content of a CSV file. name: of the file. rows: column -> value; a column that a row lacks, or whose value is
    None, is empty in the file."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[dict[str, object], ...]
