"""Declarations of tables: rows, what each row sets, and what the paper says of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from dofbench.core.errors import InputError, unknown
from dofbench.core.readable import read_toml
from dofbench.datasets.format.assignment import Assignment
from dofbench.datasets.format.inputs import Inputs
from dofbench.evaluation.results.columns import COLUMNS, HELD_OUT
from dofbench.methods.cards import find_method

# Id of the table whose rows are the variants that a method's presets were chosen among, as many for every method. It is
# run on development scenes alone.
TUNING = "tuning"
T = TypeVar("T")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Row(_Strict):
    """One row.

    label: its name. switches: the table's switch columns, yes, no or a word. method, preset: instead of the file's
    and the command line's. set: options of the method. force_all: as of `dofbench run`. paper: score -> the paper's
    figure, a mean over its scenes; paper_scenes: scene -> score -> figure. note: what to know about the row.
    """

    label: str
    switches: dict[str, bool | str] = {}
    method: str | None = None
    preset: str | None = None
    set: dict[str, Any] = {}
    force_all: bool = False
    paper: dict[str, float] = {}
    paper_scenes: dict[str, dict[str, float]] = {}
    note: str = ""


class Table(_Strict):
    """One table.

    columns: scores by id (`evaluation.results.columns`). switches: columns that say what a row has. reference: label
    of the row that the others are compared with. source: where the paper's figures stand; paper_data: what they were
    measured on. inputs: as of `dofbench run`; one for all rows, as protocols never share a table. assign: it takes
    the datasets whose lenses are assigned so (`make-dataset --assign`), or unknown, and no others; held-out ones stand
    alone.
    """

    id: str = Field(pattern=r"^[A-Za-z0-9_-]+$")
    title: str
    note: str = ""
    columns: tuple[str, ...]
    switches: tuple[str, ...] = ()
    reference: str | None = None
    source: str = ""
    paper_data: str = ""
    inputs: Inputs = "shallow"
    assign: tuple[Assignment, ...] = Field(("per-view", "continuous", "fixed", "unknown"), min_length=1)
    rows: tuple[Row, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Table:
        labels = [row.label for row in self.rows]
        for column in self.columns:
            if column not in COLUMNS:
                raise ValueError(f"unknown column {column!r}, expected one of {', '.join(COLUMNS)}")
        if HELD_OUT in self.assign and len(self.assign) > 1:
            raise ValueError(f"assign {', '.join(self.assign)}, expected {HELD_OUT} alone")
        if len(set(labels)) < len(labels):
            raise ValueError("two rows of one label")
        if self.reference is not None and self.reference not in labels:
            raise ValueError(f"reference {self.reference!r}, expected one of {', '.join(labels)}")
        for row in self.rows:
            if set(row.switches) != set(self.switches):
                raise ValueError(
                    f"row {row.label}: switches {', '.join(row.switches) or 'none'}, "
                    f"expected {', '.join(self.switches) or 'none'}"
                )
            if (row.paper or row.paper_scenes) and not (self.source and self.paper_data):
                raise ValueError(f"row {row.label}: figures of a paper without the table's source and paper_data")
        return self

    @property
    def held_out(self) -> bool:
        """Whether its test views ask for a focus that no training view has."""
        return HELD_OUT in self.assign

    def paper_columns(self) -> tuple[str, ...]:
        """Scores that the paper gives for any row."""
        given = [row.paper for row in self.rows] + [one for row in self.rows for one in row.paper_scenes.values()]
        return tuple(dict.fromkeys(column for figures in given for column in figures))


class Declaration(_Strict):
    """A file of tables. method: of the rows that name none."""

    method: str
    tables: tuple[Table, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _one_of_each_id(self) -> Declaration:
        if len({table.id for table in self.tables}) < len(self.tables):
            raise ValueError("two tables of one id")
        return self


def tables_of(method: str) -> Path:
    """The file of tables beside a method's card. Raises InputError for an unknown method."""
    return find_method(method).folder / "ablations.toml"


def read_tables(file: Path) -> Declaration:
    """Read a file of tables. Raises InputError, one line, when it is missing or wrong."""
    try:
        return Declaration.model_validate(read_toml(file, "a TOML file"))
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise InputError(file, found, "tables as dofbench.running.ablation_tables describes them") from None


def chosen_tables(declaration: Declaration, ids: tuple[str, ...]) -> tuple[Table, ...]:
    """The tables of these ids, all for none. Raises InputError for an unknown id."""
    known = {table.id: table for table in declaration.tables}
    for one in ids:
        if one not in known:
            raise unknown("--table", one, known)
    return tuple(known[one] for one in ids) if ids else declaration.tables


def of_scene(scenes: Mapping[str, dict[str, T]], scene: str) -> dict[str, T]:
    """The entry of `scenes` for the scene that a dataset was made from: that of fern for llff_fern or llff/fern; empty
    without one."""
    words = set(re.split(r"[^a-z0-9]+", scene.lower()))
    return next((found for name, found in scenes.items() if name.lower() in words), {})
