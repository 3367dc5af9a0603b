"""The measurements as CSV and Markdown."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from dofbench.core.markdown_text import literal
from dofbench.evaluation.stability.stability_options import GROUPS

# Rounding may differ by machine, so a case close to its bound may meet it on one machine and not on another; a known
# limit whose bound is met is reported as "met here".
MET, NOT_MET, KNOWN, MET_HERE = "met", "not met", "known limit", "met here"
FIELDS = ("case", "group", "backend", "precision", "error", "bound", "verdict", "note")


@dataclass(frozen=True)
class Row:
    """A case in one setting, as in the tables. note: details of the measurement, or why the bound isn't met here or
    elsewhere."""

    case: str
    group: str
    backend: str
    precision: str
    error: float
    bound: float
    verdict: str
    note: str


@dataclass(frozen=True)
class Explained:
    """The Markdown's explanation of a case: the property that must hold, and where its bound comes from."""

    holds: str
    bound: str


def csv_text(rows: Sequence[Row]) -> str:
    """One line per case and setting, with the columns `FIELDS`."""
    text = io.StringIO()
    writer = csv.DictWriter(text, FIELDS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({**asdict(row), "error": f"{row.error:.6g}", "bound": f"{row.bound:.6g}"})
    return text.getvalue()


def markdown(rows: Sequence[Row], explained: dict[str, Explained], heading: Sequence[str]) -> str:
    """The tables by group, with the property of every case; bounds that aren't met come first. heading: lines on what
    was run."""
    counts = Counter(row.verdict for row in rows)
    cases = len({(row.group, row.case) for row in rows})
    lines = [
        "# Numerical stability",
        "",
        *heading,
        "",
        f"{cases} cases, {len(rows)} rows: "
        + ", ".join(f"{counts[verdict]} {verdict}" for verdict in (MET, KNOWN, MET_HERE, NOT_MET) if counts[verdict])
        + ".",
        "",
    ]
    for verdict, title in (
        (NOT_MET, "Not met"),
        (KNOWN, "Known limits"),
        (MET_HERE, "Known limits whose bound is met here, on this machine"),
    ):
        some = [row for row in rows if row.verdict == verdict]
        if some:
            lines += [f"## {title}", "", "| case | backend | error | bound | why |", "| --- | --- | --- | --- | --- |"]
            lines += [
                f"| {row.group}/{row.case} | {row.backend} {row.precision} | {row.error:.3g} | {row.bound:.3g} | "
                f"{literal(row.note)} |"
                for row in some
            ] + [""]
    for group in GROUPS:
        some = [row for row in rows if row.group == group]
        if not some:
            continue
        lines += [
            f"## {GROUPS[group]}",
            "",
            "| case | what must hold | bound | backend | error | bound | verdict | found |",
            "| --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        before = ""
        for row in some:
            about = explained[f"{row.group}/{row.case}"]
            told = [row.case, about.holds, about.bound] if row.case != before else ["", "", ""]
            found = "" if row.verdict in (KNOWN, MET_HERE) else row.note
            cells = [
                *told,
                f"{row.backend} {row.precision}",
                f"{row.error:.3g}",
                f"{row.bound:.3g}",
                row.verdict,
                found,
            ]
            lines.append("| " + " | ".join(map(literal, cells)) + " |")
            before = row.case
        lines.append("")
    return "\n".join(lines)
