"""The run of `dofbench stability`: measures every case in every setting and writes the tables."""

from __future__ import annotations

import json
import math
import shlex
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dofbench.core.content import content_folder, method_folders
from dofbench.core.files import write_text
from dofbench.core.markdown_text import code
from dofbench.core.progress import say
from dofbench.core.source_digest import PACKAGE, source_digest
from dofbench.evaluation.results import provenance
from dofbench.evaluation.stability.case import Case, Found, Setting
from dofbench.evaluation.stability.catalogue import chosen, read_limits
from dofbench.evaluation.stability.stability_options import Stability
from dofbench.evaluation.stability.stability_table import MET_HERE, NOT_MET, Row, counted, csv_text, judged, markdown

CSV, MARKDOWN, UNFINISHED = "stability.csv", "stability.md", ".unfinished.jsonl"


def stability(settings: Stability, console: Console | None = None) -> bool:
    """Run the selected cases and write stability.csv and stability.md to `out`.

    Measurements of an interrupted run of the same code are reused. False if a bound isn't met that isn't a known
    limit. Raises InputError for a wrong call.
    """
    console = console or Console(stderr=True)
    cases = chosen(settings)
    if settings.dry_run:
        for case in cases:
            places = ", ".join(f"{setting.label} {setting.precision}" for setting in case.settings)
            say(console, f"{case.id} ({places}): {case.holds}; bound: {case.bound}")
        return True
    rows = _measure(cases, settings.out / UNFINISHED, console)
    write_text(settings.out / CSV, csv_text(rows))
    write_text(settings.out / MARKDOWN, markdown(rows, _heading(settings)))
    (settings.out / UNFINISHED).unlink(missing_ok=True)
    say(console, f"{len(rows)} rows: {counted(rows)}")
    say(console, f"{settings.out / MARKDOWN}")
    return all(row.verdict != NOT_MET for row in rows)


def measured(case: Case, setting: Setting) -> Found:
    """Run a case in a setting. An exception is an infinite error."""
    try:
        # Cases cause overflows and divisions by zero on purpose; their results are checked.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return case.measure(setting)
    except Exception as error:
        return Found(math.inf, 0.0, f"{type(error).__name__}: {' '.join(str(error).split())}"[:200])


def _measure(cases: Sequence[Case], unfinished: Path, console: Console) -> list[Row]:
    """All rows. Every measurement is appended to `unfinished`, one line of JSON each, with a digest of the code."""
    digest = source_digest([PACKAGE, content_folder("kernels"), *method_folders()], (".py", ".toml"))
    places = [(case, setting) for case in cases for setting in case.settings]
    done, limits, rows = _kept(unfinished, digest), read_limits(), []
    if known := sum(_name(*place) in done for place in places):
        say(console, f"{known} of {len(places)} rows are measured already")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    unfinished.parent.mkdir(parents=True, exist_ok=True)
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=len(places))
        for case, setting in places:
            progress.update(bar, description=case.id)
            name = _name(case, setting)
            if (found := done.get(name)) is None:
                found = measured(case, setting)
                with unfinished.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps({"code": digest, "name": name, "found": asdict(found)}) + "\n")
            row = judged(case, setting, found, limits)
            if row.verdict in (NOT_MET, MET_HERE):
                say(console, f"{row.verdict}: {name}: {row.error:.3g}, bound {row.bound:.3g}; {row.note}")
            rows.append(row)
            progress.advance(bar)
    return rows


def _kept(unfinished: Path, digest: str) -> dict[str, Found]:
    """The measurements of an interrupted run of this code; a truncated line is skipped."""
    found = {}
    for line in unfinished.read_text(encoding="utf-8").splitlines() if unfinished.is_file() else ():
        try:
            entry = json.loads(line)
            if entry["code"] == digest:
                found[entry["name"]] = Found(**entry["found"])
        except (ValueError, KeyError, TypeError, AttributeError):
            continue
    return found


def _name(case: Case, setting: Setting) -> str:
    return f"{case.id} {setting.label} {setting.precision}"


def _heading(settings: Stability) -> list[str]:
    words = ["dofbench", "stability"]
    for option, value in (("--kernel", settings.kernel), ("--method", settings.method)):
        words += [option, value] if value is not None else []
    for option, values in (("--group", settings.group), ("--case", settings.case)):
        words += [option, *values] if values else []
    git, facts, threads = provenance.git_state(), provenance.machine("cpu"), torch.get_num_threads()
    commit = "" if git is None else f", commit {str(git['commit'])[:12]}{' + changes' if git['dirty'] else ''}"
    return [
        f"{code(shlex.join(words))}{commit}; {facts['cpu']}, {threads} thread{'s' if threads != 1 else ''}, "
        f"torch {torch.__version__}.",
        "",
        "Each row is a case in one backend and precision. It is met if the error is at most the bound, which follows "
        "from the precision and the condition of the problem. A bound that isn't met is a known limit, with its "
        "reason, or makes the command end with status 1. Known limits may differ between machines: a row that meets "
        'the bound of one says "met here".',
    ]
