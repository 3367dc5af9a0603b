"""The measurements as CSV and Markdown."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.core.markdown_text import literal
from dofbench.evaluation.stability.case import Case, Found, Setting
from dofbench.evaluation.stability.catalogue import Limit, limit_of
from dofbench.evaluation.stability.stability_options import GROUPS

# Rounding differs between machines: a known limit whose bound is met on this machine is reported as "met here".
MET, NOT_MET, KNOWN, MET_HERE = "met", "not met", "known limit", "met here"
FIELDS = ("case", "group", "backend", "precision", "error", "bound", "verdict", "note")


@dataclass(frozen=True)
class Row:
    """A case in one setting, with its verdict. note: details, or why the bound isn't met here or elsewhere."""

    case: Case
    setting: Setting
    error: float
    bound: float
    verdict: str
    note: str

    @property
    def place(self) -> str:
        """Backend and precision."""
        return f"{self.setting.label} {self.setting.precision}"

    @property
    def cells(self) -> list[str]:
        """The numbers of the Markdown tables."""
        return [f"{self.error:.3g}", f"{self.bound:.3g}"]


def judged(case: Case, setting: Setting, found: Found, limits: Sequence[Limit]) -> Row:
    """The row of a measurement. The note of a known limit starts with its reason, even if the bound is met here."""
    verdict, note, limit = (MET if found.met else NOT_MET), found.note, limit_of(case, setting, limits)
    if limit is not None:
        verdict = MET_HERE if found.met else KNOWN
        note = f"{limit.reason} Here: {found.note}" if found.note else limit.reason
    return Row(case, setting, found.error, found.bound, verdict, note)


def counted(rows: Sequence[Row]) -> str:
    """The number of rows with each verdict."""
    counts = Counter(row.verdict for row in rows)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in (MET, KNOWN, MET_HERE, NOT_MET) if counts[verdict])


def csv_text(rows: Sequence[Row]) -> str:
    """One line per case and setting, with the columns `FIELDS`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(FIELDS)
    for row in rows:
        case, setting = row.case, row.setting
        numbers = f"{row.error:.6g}", f"{row.bound:.6g}"
        writer.writerow([case.name, case.group, setting.label, setting.precision, *numbers, row.verdict, row.note])
    return text.getvalue()


def markdown(rows: Sequence[Row], heading: Sequence[str]) -> str:
    """The page: bounds that aren't met, then the tables by group. heading: lines on command and machine."""
    count = len({row.case.id for row in rows})
    lines = ["# Numerical stability", "", *heading, "", f"{count} cases, {len(rows)} rows: {counted(rows)}.", ""]
    for verdict, title in (
        (NOT_MET, "Not met"),
        (KNOWN, "Known limits"),
        (MET_HERE, "Known limits whose bound is met on this machine"),
    ):
        some = [[row.case.id, row.place, *row.cells, row.note] for row in rows if row.verdict == verdict]
        lines += _table(title, ["case", "backend", "error", "bound", "why"], some)
    columns = ["case", "what must hold", "bound", "backend", "error", "bound", "verdict", "found"]
    for group, title in GROUPS.items():
        some, before = [], None
        for row in (row for row in rows if row.case.group == group):
            about = [row.case.name, row.case.holds, row.case.bound] if row.case != before else ["", "", ""]
            note = "" if row.verdict in (KNOWN, MET_HERE) else row.note
            some.append([*about, row.place, *row.cells, row.verdict, note])
            before = row.case
        lines += _table(title, columns, some)
    return "\n".join(lines)


def _table(title: str, columns: list[str], rows: list[list[str]]) -> list[str]:
    if not rows:
        return []
    cells = ["| " + " | ".join(map(literal, row)) + " |" for row in rows]
    return [f"## {title}", "", f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|", *cells, ""]
