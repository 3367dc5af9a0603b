"""Scores against training time: the Pareto front and times to reach a score, as tables and as CSV rows."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from dofbench.evaluation.comparing.score_curves import RULE, Reach, reach, reached, spans
from dofbench.reporting.curves import Plot, seconds_text
from dofbench.reporting.tables import Cell, Heading, Table, number, words


@dataclass(frozen=True)
class CurveView:
    """One score against training time. picture: file of the drawing, "" without one. front_words: the Pareto front in
    one sentence. reach: None if no score changed. front: the front as a table."""

    title: str
    plot: Plot
    picture: str
    front_words: str
    reach: Table | None
    front: Table | None

    @property
    def board(self) -> tuple[str, ...]:
        """The key of the plot's board."""
        return self.plot.board


def curve_view(plot: Plot, picture: str) -> CurveView:
    """A plot with its tables: the Pareto front, and the times to reach its levels."""
    title = f"{plot.score.label} on {plot.dataset}, {plot.protocol}"
    reach = _reach_table(plot, title) if plot.levels else None
    front = _front_table(plot, title) if plot.front else None
    return CurveView(title, plot, picture, _front_words(plot), reach, front)


def curve_rules(plots: Iterable[Plot]) -> str:
    """A paragraph that explains times, levels and fronts."""
    chosen = "; where `--reach` gave levels, they are those" if any(plot.chosen for plot in plots) else ""
    return (
        "Training time is wall time; the clock is stopped while scoring, and JIT compilation is excluded. "
        f"{RULE} The levels are 50 %, 80 % and 95 % of the way from the worst first score of any run to the best of "
        f"any method (median over its seeds), each rounded to the easier side{chosen}. The Pareto front holds the "
        "scored moments (medians over seeds) that no other method or preset beats: none is as early and as good."
    )


def _front_words(plot: Plot) -> str:
    """A sentence such as "Pareto front: A from 0.2 s (12.1 dB), B from 31 s (25.0 dB) to 412 s (31.2 dB)."."""
    if not plot.front:
        return ""

    def moment(point: tuple[float, float]) -> str:
        return f"{seconds_text(point[0])} ({f'{plot.score.text(point[1])} {plot.score.unit}'.strip()})"

    held = list(spans(plot.front))
    parts = ", ".join(f"{plot.series[place].label} from {moment(first)}" for place, first, _ in held)
    _, first, last = held[-1]
    return f"Pareto front: {parts}{'' if last == first else f' to {moment(last)}'}."


def _reach_table(plot: Plot, title: str) -> Table:
    score, sign = plot.score, "≥" if plot.higher_is_better else "≤"
    headings = [Heading(f"{score.label} {sign} {level:g} {score.unit}".strip()) for level in plot.levels]
    rows = []
    for series in plot.series:
        found = [reach(series.runs, level, higher_is_better=plot.higher_is_better) for level in plot.levels]
        times = [Cell(reach_text(one), "number", one.median if math.isfinite(one.median) else None) for one in found]
        rows.append((words(series.name, series.signs), *times))
    first = Heading("time to reach", words=True)
    caption = f"{plot.clock.capitalize()} to reach a score: {title}"
    below = (f"{len(rows)} of {plot.whole} rows, the best; `reach.csv` has all.",) if plot.whole else ()
    return Table(caption, (first, *headings), tuple(rows), below=below, rest="reach.csv")


def reach_text(found: Reach) -> str:
    """A text such as "42.1 s (40.0 s to 45.2 s)" or "not reached"."""
    if not math.isfinite(found.median):
        return "not reached" + (f" ({found.count} of {found.seeds} seeds did)" if found.count else "")
    text = seconds_text(found.median)
    if found.seeds > 1:
        high = seconds_text(found.high) if math.isfinite(found.high) else "not reached"
        text += f" ({seconds_text(found.low)} to {high})"
    if found.lost:
        text += ", lost again" + (f" by {found.lost} of {found.seeds}" if found.seeds > 1 else "")
    return text


def _front_table(plot: Plot, title: str) -> Table:
    rows = []
    for place, first, last in spans(plot.front):
        series, times, scores = plot.series[place], (first[0], last[0]), (first[1], last[1])
        name = words(series.name, series.signs)
        shown = (number(score, plot.score.text(score)) for score in scores)
        rows.append((*(number(time, seconds_text(time)) for time in times), name, *shown))
    texts = ("from", "to", "best", f"{plot.score.label} there", "until")
    headings = tuple(Heading(text, words=text == "best") for text in texts)
    caption = f"Pareto front of {title}: best method by {plot.clock}"
    return Table(caption, headings, tuple(rows), names=0, rest="pareto.csv")


def reach_rows(plots: Iterable[Plot]) -> Iterator[dict[str, object]]:
    """One row for every run and level. reached_s is empty if the level wasn't reached; the true time lies between
    not_before_s and reached_s."""
    for plot, series in ((one, series) for one in plots for series in one.series):
        who = {**plot.identity, "scene": plot.scene, "method": series.method, "preset": series.preset}
        for run, level in itertools.product(series.runs, plot.levels):
            found = reached(run, level, higher_is_better=plot.higher_is_better)
            row = {**who, "seed": run.seed, "level": level, "reached_s": found.time, "status": str(run.status)}
            if found.time is not None:
                row |= {"not_before_s": found.before, "held": "yes" if found.held else "no"}
            yield row


def front_rows(plots: Iterable[Plot]) -> Iterator[dict[str, object]]:
    """One row for every point of every front."""
    for plot, (time, score, place) in ((one, point) for one in plots for point in one.front):
        series = plot.series[place]
        yield {**plot.identity, "train_s": time, "value": score, "method": series.method, "preset": series.preset}
