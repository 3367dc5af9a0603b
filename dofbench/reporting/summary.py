"""The numbers of a table from its runs: means over seeds, means over scenes, and failures and gaps with their
reasons."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import ALL_IN_FOCUS, COLUMNS, EXIF, PHOTOGRAPH, REFOCUS, SCORES
from dofbench.evaluation.results.protocol import DEPTH_COLUMNS, PROTOCOLS, arithmetic_mean

DO_NOTHING = "do nothing (Â = F̂ = 0.5)"


@dataclass(frozen=True)
class Statistic:
    """A score over several runs. value: a number, or None with a failure or a reason.

    spread: sample standard deviation over seeds, None for a single seed. failure: a status, shown by its name. reason:
    text of the footnote.
    """

    value: float | None
    spread: float | None = None
    failure: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Line:
    """One line of a table: cells by column. competes: whether the line can be the best. signs: what it doesn't prove
    (`dofbench.reporting.standing`)."""

    method: str
    preset: str
    seeds: str
    cells: dict[str, Statistic]
    competes: bool = True
    signs: str = ""

    @property
    def name(self) -> str:
        """Method and preset."""
        return f"{self.method} {self.preset}".strip()


def seed_mean(entries: list[Entry], column: str) -> Statistic:
    """One column over the seeds of one variant. If a seed failed, there is no mean; failed seeds aren't left out."""
    failed = [entry for entry in entries if entry.status is not Status.OK]
    if failed:
        kinds = ", ".join(sorted({str(entry.status) for entry in failed}))
        count = f" ({len(failed)} of {len(entries)} seeds)" if len(entries) > 1 else ""
        return Statistic(None, failure=kinds + count, reason=failed[0].message or "no message")
    values = [entry.scores[column] for entry in entries if column in entry.scores]
    if len(values) < len(entries):
        gap = next(entry for entry in entries if column not in entry.scores)
        return Statistic(None, reason=gap.left_out.get(column) or _no_reason(gap, column))
    return mean_and_spread(values)


def mean_and_spread(values: Sequence[float], reason: str = "") -> Statistic:
    """Mean and sample standard deviation of one value per seed; a gap with the reason if there are no values."""
    if not values:
        return Statistic(None, reason=reason)
    spread = statistics.stdev(values) if len(values) > 1 and all(map(math.isfinite, values)) else None
    return Statistic(arithmetic_mean(values), spread)


def _no_reason(entry: Entry, column: str) -> str:
    protocol = PROTOCOLS.get(entry.spec.protocol)
    if protocol is not None and column in DEPTH_COLUMNS and not protocol.depth:
        return f"{protocol.id} has no such score"
    if column in EXIF:
        return ""  # the protocol scores photographs of known lens, which don't have these columns
    if (
        protocol is not None
        and column in (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH)
        and column not in (*protocol.refocus_columns, *protocol.all_in_focus_columns, *protocol.photograph)
    ):
        return ""  # the column belongs to another protocol with other tables, so it isn't missing here
    if column not in SCORES:
        return "not computed: `dofbench score` adds it"
    return "the result holds no such score, nor a reason"


def variant_line(
    entries: list[Entry], names: dict[tuple[str, ...], tuple[str, str]], columns: Sequence[str], signs: str = ""
) -> Line:
    """The line of one variant: all of its seeds on one dataset. signs: as of `Line`."""
    method, preset = names[entries[0].variant]
    cells = {column: seed_mean(entries, column) for column in columns}
    return Line(method, preset, seeds_text([entry.spec.seed for entry in entries]), cells, signs=signs)


def seeds_text(seeds: Sequence[int]) -> str:
    """A text such as "0, 1, 2 (n = 3)"; a single seed without the count."""
    return ", ".join(map(str, seeds)) + (f" (n = {len(seeds)})" if len(seeds) > 1 else "")


def do_nothing_line(entries: list[Entry], columns: list[str]) -> Line | None:
    """The line of a lens predictor that learns nothing; None if no result has its scores."""
    known = next((entry.result.do_nothing for entry in entries if entry.result and entry.result.do_nothing), None)
    if known is None:
        return None
    gap = Statistic(None, reason="not a method: it only says that every lens is A = F = 0.5")
    cells = {column: Statistic(known[column]) if column in known else gap for column in columns}
    return Line(DO_NOTHING, "", "", cells, competes=False)


def sorted_lines(lines: list[Line]) -> list[Line]:
    """The lines sorted: best refocus PSNR first; then lines without it, by all-in-focus PSNR; failures at the end.
    Results on photographs of unknown lens, which have neither, are sorted by the PSNR of the photographs."""

    def place(line: Line) -> tuple[Any, ...]:
        refocus, sharp = (line.cells[column].value for column in ("psnr", "aif_psnr"))
        if sharp is None:
            sharp = next(
                (
                    cell.value
                    for column in ("photo_psnr", "across_psnr")
                    if (cell := line.cells.get(column)) is not None and cell.value is not None
                ),
                None,
            )
        return (
            not line.competes,
            refocus is None and sharp is None,
            refocus is None,
            -_number(refocus),
            -_number(sharp),
            line.method,
            line.preset,
        )

    return sorted(lines, key=place)


def best_texts(lines: Sequence[Line], columns: Sequence[str]) -> dict[str, str | None]:
    """For each column the best value in its rounded form, so that values that look equal are all marked."""
    return {
        column: COLUMNS[column].best(
            [value for line in lines if line.competes and (value := line.cells[column].value) is not None]
        )
        for column in columns
    }


def empty_columns(lines: Sequence[Line], columns: Sequence[str]) -> dict[str, str]:
    """The columns in which no competing line has a value or a failure, with the reasons; the reason is "" for a column
    that the protocol doesn't have, which isn't mentioned."""
    empty = {}
    for column in columns:
        cells = [line.cells[column] for line in lines if line.competes]
        if cells and not any(cell.value is not None or cell.failure for cell in cells):
            empty[column] = "; ".join(dict.fromkeys(cell.reason for cell in cells if cell.reason))
    return empty


def scene_mean(lines: dict[str, Line], scenes: list[str], column: str) -> Statistic:
    """Mean over scenes of one variant (scene -> its line); a gap unless every scene has a value."""
    missing = [scene for scene in scenes if scene not in lines or lines[scene].cells[column].value is None]
    if missing:
        gaps = {
            (cell.failure, cell.reason) for scene in missing if scene in lines if (cell := lines[scene].cells[column])
        }
        if len(missing) == len(scenes) and len(gaps) == 1:
            failure, reason = gaps.pop()  # the score is missing on all scenes for the same reason
            return Statistic(None, failure=failure, reason=reason)
        return Statistic(
            None, reason=f"no mean over an incomplete set: {', '.join(missing)} missing of {len(scenes)} scenes"
        )
    values = [lines[scene].cells[column].value for scene in scenes]
    return Statistic(arithmetic_mean([value for value in values if value is not None]))


def scene_spread(seeds: Sequence[list[Entry]], column: str) -> float | None:
    """Sample standard deviation over seeds of the mean over scenes. seeds: the variant's runs on every scene. None
    unless there are several seeds and they are the same on all scenes."""
    by_scene = [{entry.spec.seed: entry.scores.get(column) for entry in own} for own in seeds]
    common = sorted(by_scene[0])
    if len(common) < 2 or any(sorted(own) != common for own in by_scene):
        return None
    rows = [[own[seed] for own in by_scene] for seed in common]
    means = [arithmetic_mean([value for value in row if value is not None]) for row in rows if None not in row]
    return statistics.stdev(means) if len(means) == len(common) and all(map(math.isfinite, means)) else None


def _number(value: float | None) -> float:
    return -math.inf if value is None or math.isnan(value) else value
