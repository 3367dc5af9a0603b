"""The run of `dofbench stability`: measures and judges every case in every setting, and writes the tables."""

from __future__ import annotations

import math
import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dofbench.core.files import write_text
from dofbench.core.markdown_text import code
from dofbench.core.progress import say
from dofbench.evaluation.results import provenance
from dofbench.evaluation.stability.case import Case, Found, Setting
from dofbench.evaluation.stability.catalogue import chosen
from dofbench.evaluation.stability.limits import Limit, limit_of, read_limits
from dofbench.evaluation.stability.stability_options import Stability
from dofbench.evaluation.stability.stability_table import (
    KNOWN,
    MET,
    MET_HERE,
    NOT_MET,
    Explained,
    Row,
    csv_text,
    markdown,
)
from dofbench.evaluation.stability.unfinished import Unfinished

CSV, MARKDOWN = "stability.csv", "stability.md"


def stability(settings: Stability, console: Console | None = None) -> bool:
    """Run the cases that are asked for and write stability.csv and stability.md to `out`.

    Measurements that an interrupted run of the same code has finished aren't repeated. False if a bound isn't met and
    this isn't a known limit. Raises InputError for a wrong call.
    """
    console = console or Console(stderr=True)
    cases, limits = chosen(settings), read_limits()
    if settings.dry_run:
        for case in cases:
            places = ", ".join(f"{setting.label} {setting.precision}" for setting in case.settings)
            say(console, f"{case.id} ({places}): {case.holds}; bound: {case.bound}")
        return True
    rows = _measure(cases, limits, Unfinished(settings.out), console)
    explained = {case.id: Explained(case.holds, case.bound) for case in cases}
    write_text(settings.out / CSV, csv_text(rows))
    write_text(settings.out / MARKDOWN, markdown(rows, explained, _heading(settings)))
    Unfinished(settings.out).forget()
    return _report(rows, settings.out, console)


def measured(case: Case, setting: Setting) -> Found:
    """Run a case in a setting. If it raises an exception, its error is infinite."""
    try:
        # Cases cause overflows and divisions by zero on purpose; their results are checked.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return case.measure(setting)
    except Exception as error:
        return Found(math.inf, 0.0, f"{type(error).__name__}: {' '.join(str(error).split())}"[:200])


def judged(case: Case, setting: Setting, found: Found, limits: Sequence[Limit]) -> Row:
    """The row of a measurement, with its verdict. The note of a known limit begins with the limit's reason, even if the
    bound is met here."""
    limit = limit_of(case, setting, limits)
    if limit is None:
        verdict, note = (MET if found.met else NOT_MET), found.note
    else:
        verdict = MET_HERE if found.met else KNOWN
        note = f"{limit.reason} Here: {found.note}" if found.note else limit.reason
    return Row(case.name, case.group, setting.label, setting.precision, found.error, found.bound, verdict, note)


def _measure(cases: Sequence[Case], limits: Sequence[Limit], kept: Unfinished, console: Console) -> list[Row]:
    places = [(case, setting) for case in cases for setting in case.settings]
    done, rows = kept.read(), []
    if known := sum(_name(case, setting) in done for case, setting in places):
        say(console, f"{known} of {len(places)} are measured already")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=len(places))
        for case, setting in places:
            progress.update(bar, description=case.id)
            found = done.get(_name(case, setting))
            if found is None:
                found = measured(case, setting)
                kept.keep(_name(case, setting), found)
            row = judged(case, setting, found, limits)
            if row.verdict in (NOT_MET, MET_HERE):
                say(
                    console,
                    f"{row.verdict}: {_name(case, setting)}: {row.error:.3g}, bound {row.bound:.3g}; {row.note}",
                )
            rows.append(row)
            progress.advance(bar)
    return rows


def _name(case: Case, setting: Setting) -> str:
    return f"{case.id} {setting.label} {setting.precision}"


def _report(rows: Sequence[Row], out: Path, console: Console) -> bool:
    counts = {verdict: sum(row.verdict == verdict for row in rows) for verdict in (MET, KNOWN, MET_HERE, NOT_MET)}
    say(console, f"{len(rows)} rows: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count))
    say(console, f"{out / MARKDOWN}")
    return counts[NOT_MET] == 0


def _heading(settings: Stability) -> list[str]:
    words = ["dofbench", "stability"]
    for option, value in (("--kernel", settings.kernel), ("--method", settings.method)):
        words += [option, value] if value is not None else []
    for option, values in (("--group", settings.group), ("--case", settings.case)):
        words += [option, *values] if values else []
    git, facts = provenance.git_state(), provenance.machine("cpu")
    commit = "" if git is None else f", commit {str(git['commit'])[:12]}{' + changes' if git['dirty'] else ''}"
    return [
        f"{code(shlex.join(words))}{commit}; {facts['cpu']}, {torch.get_num_threads()} thread"
        f"{'s' if torch.get_num_threads() != 1 else ''}, torch {torch.__version__}.",
        "",
        "Each row is a case in one backend and precision. It is met where the error is at most the bound, which "
        "follows from precision and the problem's condition, not from what was measured. A bound that isn't met is "
        "either a known limit, with its reason, or makes the command end with status 1. Known limits may differ by "
        'machine: a row that meets the bound of one says "met here".',
    ]
