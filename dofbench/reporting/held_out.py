"""The table for datasets whose test views have a focus that no training view has, by the test views' lenses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.protocol import AIF_PREFIX, arithmetic_mean
from dofbench.reporting import table_cells
from dofbench.reporting.score_table import Beside, score_table
from dofbench.reporting.summary import Line, mean_and_spread
from dofbench.reporting.view import Section

COLUMNS_SHOWN = ("psnr", "ssim", "flip")  # metrics that all-in-focus renderings have too
ASKED_HEADING = "Held-out focus, by what the test views ask for"
ALL_IN_FOCUS = "A 0, all in focus"
_BESIDE = Beside(
    table_cells.word_headings("method", "asked for"),
    lambda line: [table_cells.words(line.name, line.signs), table_cells.words(line.seeds)],
)


def asked_section(groups: Iterable[tuple[Line, list[Entry]]], dataset: str) -> Section | None:
    """Scores by the lens of the test views, and all in focus. groups: (line of all scores, its seeds).

    A group with a failed run is left out here, as the table of all scores shows it. None if no group is left.
    """
    lines = [line for whole, seeds in groups for line in _lines(whole, seeds)]
    if not lines:
        return None
    table = score_table(lines, COLUMNS_SHOWN, f"{ASKED_HEADING}: {dataset}", before=_BESIDE)
    return Section(ASKED_HEADING, (table,))


def _lines(whole: Line, seeds: list[Entry]) -> list[Line]:
    results = [entry.result for entry in seeds if entry.status is Status.OK and entry.result is not None]
    if not results or len(results) < len(seeds):
        return []
    asked: dict[tuple[float, float], list[str]] = {}
    for view, lens in results[0].plan["lenses"]["test"].items():
        if lens is not None:  # None: an unknown lens
            asked.setdefault((lens[1], lens[0]), []).append(view)
    rows = [
        (f"F {focus:g}, A {aperture:g}", views, "")
        for (focus, aperture), views in sorted(asked.items())
        if aperture > 0
    ]
    rows.append((ALL_IN_FOCUS, list(results[0].plan["lenses"]["test"]), AIF_PREFIX))
    lines = []
    for name, views, prefix in rows:
        by_seed = [{view.name: view.scores for view in result.views if view.name in views} for result in results]
        cells = {}
        for column in COLUMNS_SHOWN:
            known = all(prefix + column in scores for run in by_seed for scores in run.values())
            values = (
                [arithmetic_mean([scores[prefix + column] for scores in run.values()]) for run in by_seed]
                if known
                else []
            )
            cells[column] = mean_and_spread(values, results[0].left_out.get(prefix + column, "no such score"))
        if any(cell.value is not None for cell in cells.values()):
            count = f"{len(views)} view{'s' if len(views) > 1 else ''}"
            asked_for = f"{name} ({count})"
            lines.append(replace(whole, seeds=asked_for, cells=cells, competes=False))
    return lines
