"""Error rates from the rows of `check.py`, by kind of case, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from dofbench.core.files import write_text
from dofbench.methods.stages.stage_deciders import CLEAR_BLUR, NEEDLESS_BLUR

Row = dict[str, str]


def by_points(row: Row) -> bool:
    """The decision whether there is a lens, by the estimate from sparse points alone."""
    return not row["points_px"] or float(row["points_px"]) >= NEEDLESS_BLUR


def by_trial(row: Row) -> bool:
    """The decision whether there is a lens, by the trial while training."""
    return row["tried"] == "yes"


def by_both(row: Row) -> bool:
    """As `harness/plan.py` has it: a clear estimate needs no trial."""
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


def write_table(path: Path, rows: Sequence[Row], costs: Sequence[Row]) -> None:
    """Error rates, mistakes one by one, and what they cost."""
    lines = ["By `python -m benchmarks.lens.check`. Shares with their 95 % interval."]
    for steps in sorted({row["steps"] for row in rows}, key=int):
        lines += ["", *_of_length(steps, [row for row in rows if row["steps"] == steps])]
    if costs:
        lines += ["", *_costs(costs)]
    write_text(path, "\n".join(lines) + "\n")


def _of_length(steps: str, rows: Sequence[Row]) -> list[str]:
    good = [row for row in rows if row["status"] == "ok" and row["tried"]]
    lines = [
        f"## {steps} steps: {len(rows)} cases, of which {len(good)} came to a decision",
        "",
        *_rates(good),
        "",
        *_by_kind(good),
        "",
        *_sharing(good),
        "",
        *_mistakes(good),
        "",
        *_seconds(good),
    ]
    if bad := [row for row in rows if row not in good]:
        lines += ["", "No decision:", "", *(f"- {row['case']}: {row['status']}" for row in bad)]
    return lines


def _rates(rows: Sequence[Row]) -> list[str]:
    lines = ['| rule | false "no lens" | false "lens" | faint lenses kept |', "| :--- | ---: | ---: | ---: |"]
    lens, none, faint = ([row for row in rows if row["lens"] == truth] for truth in ("yes", "no", "faint"))
    for rule in RULES:
        lines.append(
            f"| {rule} | {rate(sum(wrong(row, rule) != '' for row in lens), len(lens))} | "
            f"{rate(sum(wrong(row, rule) != '' for row in none), len(none))} | "
            f"{sum(RULES[rule](row) for row in faint)} of {len(faint)} |"
        )
    return lines


def _by_kind(rows: Sequence[Row]) -> list[str]:
    lines = [
        '| kind | truth | cases | called "lens" by points | by trial | by both |',
        "| :--- | :--- | ---: | ---: | ---: | ---: |",
    ]
    for kind, truth in sorted({(row["kind"], row["lens"]) for row in rows}):
        some = [row for row in rows if (row["kind"], row["lens"]) == (kind, truth)]
        said = " | ".join(str(sum(rule(row) for row in some)) for rule in RULES.values())
        lines.append(f"| {kind} | {truth} | {len(some)} | {said} |")
    return lines


def _sharing(rows: Sequence[Row]) -> list[str]:
    asked = [row for row in rows if row["shared"] and row["share"] and row["lens"] == "yes"]
    lines = [
        "What photographs share, where there is a lens and it was kept:",
        "",
        f"| truth | cases | {' | '.join(FITTING)} | shared too much | needlessly apart |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for truth in FITTING:
        some = [row for row in asked if row["share"] == truth]
        said = " | ".join(str(sum(row["shared"] == way for row in some)) for way in FITTING)
        errors = " | ".join(
            rate(sum(wrongly_shared(row) == error for row in some), len(some)) for error in ("shared", "apart")
        )
        lines.append(f"| {truth} | {len(some)} | {said} | {errors} |")
    lines += [
        "",
        "| case | truth | decided | foci apart | scene | aperture | error |",
        "| :--- | :--- | :--- | ---: | ---: | ---: | :--- |",
    ]
    for row in asked:
        if error := wrongly_shared(row):
            gains = " | ".join(_dB(row, f"{way}_gain", f"{way}_error") for way in ("scene", "aperture"))
            lines.append(
                f"| {row['case']} | {row['share']} | {row['shared']} | {_px(row['apart'])} | {gains} | {error} |"
            )
    return lines


def _mistakes(rows: Sequence[Row]) -> list[str]:
    lines = [
        "Every mistake of the trial:",
        "",
        "| case | true circle | points | circle | gain | said |",
        "| :--- | ---: | ---: | ---: | ---: | :--- |",
    ]
    for row in rows:
        if error := wrong(row, "trial"):
            lines.append(
                f"| {row['case']} | {_px(row['true_circle'])} | {_px(row['points_px'])} | "
                f"{_px(row['circle'])} | {_dB(row, 'gain', 'error')} | {error} |"
            )
    return lines


def _seconds(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return []
    spent, trials = (sum(float(row[name]) for row in rows) / len(rows) for name in ("seconds", "trials_s"))
    return [f"A case took {spent:.0f} s to its decision on average, of which {trials:.0f} s the trials."]


def _costs(rows: Sequence[Row]) -> list[str]:
    lines = [
        "## Trained to the end",
        "",
        "A lens a photograph (on), none (off), one aperture with a focus each (aperture), one lens (scene).",
        "",
        "| case | way | steps | held back, dB | all in focus, dB | processor ms a step |",
        "| :--- | :--- | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        if row["status"] == "ok":
            sharp = f"{float(row['aif_psnr']):.2f}" if row["aif_psnr"] else "–"
            lines.append(
                f"| {row['case']} | {row['way']} | {row['steps']} | {float(row['held_back_psnr']):.2f} | "
                f"{sharp} | {float(row['ms_a_step']):.0f} |"
            )
        else:
            lines.append(f"| {row['case']} | {row['way']} | {row['steps']} | {row['status']} | – | – |")
    return lines


def _px(value: str) -> str:
    return f"{float(value):.2f}" if value else "–"


def _dB(row: Row, value: str, error: str) -> str:
    return f"{float(row[value]):+.3f} ± {float(row[error]):.3f}" if row.get(value) else "–"
