"""Error rates from the rows of `check.py`: rates.csv, circles.csv, kinds.csv and sharing.csv."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from dofbench.core.files import write_csv
from dofbench.methods.stages.stage_deciders import CLEAR_BLUR, NEEDLESS_BLUR
from dofbench.training.gaussians.trials import keeps_lens

Row = dict[str, str]


def by_points(row: Row) -> bool:
    """Whether there is a lens, by the estimate from sparse points alone."""
    return not row["points_px"] or float(row["points_px"]) >= NEEDLESS_BLUR


def by_trial(row: Row) -> bool:
    """Whether there is a lens, by the A/B check during training: by today's rule on what the check measured."""
    return keeps_lens(*(float(row[name]) for name in ("gain", "error", "circle")))


def by_both(row: Row) -> bool:
    """As a plan has it: a clear estimate needs no check."""
    return (bool(row["points_px"]) and float(row["points_px"]) >= CLEAR_BLUR) or by_trial(row)


RULES: dict[str, Callable[[Row], bool]] = {"points": by_points, "trial": by_trial, "both": by_both}
# Truth -> decisions that count as right: photographs that share the lens also share an aperture, and photographs at one
# f-number that share an aperture also share aperture times f-number.
FITTING = {
    "scene": ("scene", "aperture", "exif"),
    "aperture": ("aperture", "exif"),
    "exif": ("exif",),
    "view": ("view",),
}
CIRCLES = (0.75, 1.0, 1.3, 2.0, math.inf)  # limits of true CoC radii, pixels


def wrong(row: Row, rule: str) -> str:
    """The wrong decision, "no lens" or "lens"; "" if the decision is right or the lens is faint."""
    said = RULES[rule](row)
    return {("yes", False): "no lens", ("no", True): "lens"}.get((row["lens"], said), "")


def wrongly_shared(row: Row) -> str:
    """The mistake: "shared" if more is shared than is true, "apart" if nothing is shared but could be; else ""."""
    if not row["share"] or not row["shared"] or row["shared"] in FITTING[row["share"]]:
        return ""
    return "apart" if row["shared"] == "view" else "shared"


def rate(count: int, of: int) -> str:
    """Count and share with the 95 % interval of a binomial share (Wilson, 1927)."""
    if not of:
        return "–"
    z, p = 1.96, count / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    reach = z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of)) / (1 + z * z / of)
    return f"{count} of {of} ({100 * max(0.0, middle - reach):.0f}–{100 * min(1.0, middle + reach):.0f} %)"


def write_tables(folder: Path, rows: Sequence[Row]) -> None:
    """Write the four tables, each by length of the training; cases without a decision don't count."""
    tables = {"rates": _rates, "circles": _circles, "kinds": _kinds, "sharing": _sharing}
    for name, table in tables.items():
        lines: list[dict[str, Any]] = []
        for steps in sorted({row["steps"] for row in rows}, key=int):
            decided = [r for r in rows if r["steps"] == steps and r["status"] == "ok" and r["tried"]]
            lines += [{"steps": steps, **line} for line in table(decided)]
        if lines:
            write_csv(folder / f"{name}.csv", tuple(lines[0]), lines)


def _wrong(rows: Iterable[Row], rule: str = "trial") -> int:
    return sum(wrong(row, rule) != "" for row in rows)


def _rates(rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """How often each rule is wrong."""
    lens, none, faint = ([row for row in rows if row["lens"] == truth] for truth in ("yes", "no", "faint"))
    for rule, says in RULES.items():
        yield {
            "rule": rule,
            "false_none": rate(_wrong(lens, rule), len(lens)),
            "false_lens": rate(_wrong(none, rule), len(none)),
            "faint_kept": f"{sum(map(says, faint))} of {len(faint)}",
        }


def _circles(rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Lenses that the check missed, by true CoC radius and whether all views share the lens."""
    lens = [row for row in rows if row["lens"] == "yes" and row["true_circle"]]
    for low, high in pairwise(CIRCLES):
        within = [row for row in lens if low <= float(row["true_circle"]) < high]
        one, several = ([row for row in within if (row["share"] == "scene") is same] for same in (True, False))
        counts = {"one_missed": _wrong(one), "one_of": len(one)}
        counts |= {"several_missed": _wrong(several), "several_of": len(several)}
        yield {"low": low, "high": "" if math.isinf(high) else high, **counts}


def _kinds(rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """How many cases of each kind each rule calls a lens."""
    for kind, truth in sorted({(row["kind"], row["lens"]) for row in rows}):
        some = [row for row in rows if (row["kind"], row["lens"]) == (kind, truth)]
        said = {rule: sum(map(says, some)) for rule, says in RULES.items()}
        yield {"kind": kind, "truth": truth, "cases": len(some), **said}


def _sharing(rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """What views share, where there is a lens and it was kept."""
    asked = [row for row in rows if row["shared"] and row["share"] and row["lens"] == "yes" and by_trial(row)]
    for truth in FITTING:
        some = [row for row in asked if row["share"] == truth]
        errors = {
            error: rate(sum(wrongly_shared(row) == error for row in some), len(some)) for error in ("shared", "apart")
        }
        said = {way: sum(row["shared"] == way for row in some) for way in FITTING}
        yield {"truth": truth, "cases": len(some), **said, **errors}
