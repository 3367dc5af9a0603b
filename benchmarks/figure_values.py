"""Values of CSV files by name, and arithmetic with them: what figures on pages are compared with."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]


class NoSuchValue(ValueError):
    """A name, row or column that the CSV doesn't have."""


class Rows:
    """The rows of a CSV that fit. `rows.column` is a column's value (a list of several rows' values), None for an empty
    cell; with `by`, `rows.name` are the rows whose column `by` has that name. `rows["name"]` is the same for names that
    aren't words."""

    def __init__(self, records: Sequence[Record], by: Sequence[str], where: str):
        self._records, self._by, self._where = records, tuple(by), where

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return self[name]

    def __getitem__(self, name: str) -> Any:
        if self._by:
            found = [record for record in self._records if str(record[self._by[0]]) == name]
            if not found:
                raise NoSuchValue(f"{self._where}: no row whose {self._by[0]} is {name}")
            return Rows(found, self._by[1:], f"{self._where}, {name}")
        if name not in self._records[0]:
            raise NoSuchValue(f"{self._where}: no column {name}; there are {', '.join(self._records[0])}")
        values = [record[name] for record in self._records]
        return values[0] if len(values) == 1 else values

    def __contains__(self, name: str) -> bool:
        if self._by:
            return any(str(record[self._by[0]]) == name for record in self._records)
        return bool(self._records) and name in self._records[0]

    def __len__(self) -> int:
        return len(self._records)

    def names(self) -> list[str]:
        """The names that the rows have by `by`, in their order."""
        return list(dict.fromkeys(str(record[self._by[0]]) for record in self._records))

    def where(self, condition: str) -> Rows:
        """The rows for which a condition on their columns holds, for example "delta_a < 0.02"."""
        found = [record for record in self._records if evaluate(condition, dict(record))]
        return Rows(found, self._by, f"{self._where}, {condition}")

    def only(self, **wanted: Any) -> Rows:
        """The rows whose columns have these values."""
        found = [
            record for record in self._records if all(_same(record[name], value) for name, value in wanted.items())
        ]
        return Rows(found, self._by, f"{self._where}, {wanted}")

    def among(self, column: str, values: Sequence[Any]) -> Rows:
        """The rows whose column has one of the values."""
        found = [record for record in self._records if record[column] in values]
        return Rows(found, self._by, f"{self._where}, {column}")


def select(folder: Path, chosen: Mapping[str, Any]) -> Rows:
    """The rows of `chosen["csv"]`, a path from the folder, whose columns have the values of the other keys; `by`: see
    `Rows`. Raises NoSuchValue for a missing file, column or row."""
    wanted = {key: value for key, value in chosen.items() if key not in ("csv", "by")}
    file = folder / chosen["csv"]
    if not file.is_file():
        raise NoSuchValue(f"{file}: no such file")
    records = _read(file)
    for column in wanted:
        if column not in records[0]:
            raise NoSuchValue(f"{file.name}: no column {column}; there are {', '.join(records[0])}")
    found = [record for record in records if all(_same(record[column], value) for column, value in wanted.items())]
    words = ", ".join(f"{column} {value}" for column, value in wanted.items())
    if not found:
        raise NoSuchValue(f"{file.name}: no row with {words}")
    by = chosen.get("by", ())
    return Rows(found, (by,) if isinstance(by, str) else tuple(by), f"{file.name}: {words}")


def csv_values(file: Path) -> list[float]:
    """Every number of a CSV. Raises NoSuchValue for a missing file."""
    if not file.is_file():
        raise NoSuchValue(f"{file}: no such file")
    return [value for record in _read(file) for value in record.values() if isinstance(value, float)]


def evaluate(expression: str, names: Mapping[str, Any]) -> Any:
    """The value of a Python expression of names, numbers and the functions below. The expressions are those of the
    repository's own files. Raises NoSuchValue, with the expression, for whatever can't be computed."""
    try:
        return eval(expression, {"__builtins__": {}, **_FUNCTIONS}, _Names(names))
    except NoSuchValue:
        raise
    except Exception as error:
        raise NoSuchValue(f"{expression}: {error}") from None


class _Names(dict[str, Any]):
    """What an expression's names are: first what the table's row has, then the page's names, then functions."""

    def __getitem__(self, name: str) -> Any:
        rows = self.get("row")
        if isinstance(rows, Rows) and name in rows:
            return rows[name]
        if name in self or name in _FUNCTIONS:
            return super().__getitem__(name)  # without the name, KeyError: a function is looked up elsewhere
        if isinstance(rows, Rows):
            return rows[name]
        raise NoSuchValue(f"{name}: no row of that name")


def _mean(values: Any) -> float | None:
    there = _list(values)
    return statistics.fmean(there) if there else None


def _sd(values: Any) -> float | None:
    several = _list(values)
    return statistics.stdev(several) if len(several) > 1 else None


def _median(values: Any) -> float:
    return statistics.median(_list(values))


def _least(*values: Any) -> float:
    return min(number for value in values for number in _list(value))


def _largest(*values: Any) -> float:
    return max(number for value in values for number in _list(value))


def _capped(values: Any, limit: float) -> list[float]:
    """The values, none above the limit: an infinite PSNR as one of 100 dB."""
    return [min(value, limit) for value in _list(values)]


def _distance(values: Any, place: float) -> float:
    """Mean distance of the values from a place."""
    return statistics.fmean(abs(value - place) for value in _list(values))


def _tally(rows: Rows, condition: str) -> list[float]:
    """How many rows a condition holds for, and how many there are."""
    return [len(rows.where(condition)), len(rows)]


def _portion(rows: Rows, condition: str) -> list[float]:
    """The same, and the 95 % interval of the share in per cent (Wilson, 1927)."""
    found, of = _tally(rows, condition)
    z, p = 1.96, found / of
    middle, reach = p + z * z / (2 * of), z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of))
    return [found, of, *(max(0.0, 100 * (middle + side * reach) / (1 + z * z / of)) for side in (-1, 1))]


def _differences(one: list[float], other: list[float]) -> list[float]:
    """Of two lists, place by place."""
    return [a - b for a, b in zip(one, other, strict=True)]


@cache
def _paper(method: str, layout: str, column: str) -> float | None:
    """What the paper prints of a method, by its id; None if nothing."""
    from dofbench.reporting.paper import paper_figures
    from dofbench.running.method_cards import find_method

    return paper_figures()[layout].means.get(find_method(method).card.name, {}).get(column)


def _list(values: Any) -> list[float]:
    return [value for value in (values if isinstance(values, list) else [values]) if value is not None]


_FUNCTIONS: dict[str, Any] = {
    "mean": _mean,
    "sd": _sd,
    "median": _median,
    "least": _least,
    "largest": _largest,
    "capped": _capped,
    "distance": _distance,
    "tally": _tally,
    "portion": _portion,
    "differences": _differences,
    "paper": _paper,
    "count": len,
    "abs": abs,
    "round": round,
    "sqrt": math.sqrt,
    "log10": math.log10,
    "sum": lambda values: math.fsum(_list(values)),
}


@cache
def _read(file: Path) -> list[dict[str, Any]]:
    with file.open(encoding="utf-8", newline="") as stream:
        records = [{key: _value(text) for key, text in record.items()} for record in csv.DictReader(stream)]
    if not records:
        raise NoSuchValue(f"{file}: no rows")
    return records


def _value(text: str) -> float | str | None:
    if text == "":
        return None
    try:
        return float(text)
    except ValueError:
        return text


def _same(known: Any, wanted: Any) -> bool:
    if isinstance(known, float):
        return str(known) == str(wanted) or known == _value(str(wanted))
    return ("" if known is None else str(known)) == str(wanted)
