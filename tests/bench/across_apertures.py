"""Photographs of one aperture predicted from those of another, and learned apertures against EXIF, beside their aims:
across-apertures.csv and across-apertures.md, of finished runs.

    dofbench make-dataset SCENES/shallow_blowtorch --photographs shallow --layout colmap --width 530 \\
        --train-f-number 6.3 --test-f-number 14 --out data/across
    dofbench run --method dofgaussian,mipsplatting --data data/across --budget 1500it --seeds 3 --out results
    python tests/bench/across_apertures.py --results results --out reports/photographs
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from dofbench.errors import Status
from dofbench.files import write_text
from dofbench.harness.protocol import ACROSS_COLUMNS, EXIF_COLUMNS
from dofbench.harness.result import RESULT_FILE, Result, read_result
from dofbench.metrics.exif_errors import exif_errors
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.tables import write_csv

FIELDS = ("method", "options", "preset", "budget", "seed", "protocol", "dataset_checksum", *ACROSS_COLUMNS,
          *EXIF_COLUMNS, "exif_deviation", "train_s", "fit_s", "key")
AIMS = {"exif_spread": 15.0, "exif_ratio": 10.0}  # per cent, at most
AHEAD = 2.0                                       # dB above a method without a lens, where blurred


@dataclass(frozen=True)
class Settings:
    """What to write of which runs."""

    results: Path
    """Folder of results."""
    out: Path
    """Folder for across-apertures.csv and across-apertures.md."""


def row_of(result: Result) -> dict[str, object]:
    """One run. exif_deviation: sample standard deviation over mean, per cent, beside the robust spread."""
    spec = result.spec
    errors = exif_errors([(view.aperture, view.f_number) for view in result.apertures])
    return {
        **{name: getattr(spec, name) for name in ("method", "preset", "budget", "seed", "protocol")},
        "options": " ".join(f"{name}={value}" for name, value in sorted(spec.overrides.items())),
        "dataset_checksum": spec.dataset_checksum[:16], "key": result.key[:8], "exif_deviation": errors.deviation,
        "fit_s": sum(fit.seconds for fit in result.fits), **result.scores,
    }


def variants(results: list[Result]) -> dict[tuple[str, ...], list[Result]]:
    """Runs that differ in their seed alone, by (data, protocol, budget, method, options)."""
    found: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        spec = result.spec
        options = " ".join(f"{name}={value}" for name, value in sorted(spec.overrides.items()))
        key = (spec.dataset_checksum[:8], spec.protocol, spec.budget, f"{spec.method} {options}".strip())
        found.setdefault(key, []).append(result)
    return found


def spread(values: list[float], column: str) -> str:
    """Mean and, of several, sample standard deviation, in the column's digits."""
    text = COLUMNS[column].text
    mean = text(float(np.mean(values)))
    return mean if len(values) < 2 else f"{mean} ± {text(float(np.std(values, ddof=1)))}"


def markdown(results: list[Result]) -> str:
    """The tables, means over seeds, and how far the aims were reached."""
    notes = Footnotes()
    lines = ["# One aperture predicted from another, and apertures against EXIF", "",
             "Written by `tests/bench/across_apertures.py`, whose head has the commands. Mean ± standard deviation "
             "over seeds.", ""]
    columns = (*ACROSS_COLUMNS, *EXIF_COLUMNS)
    groups, rows = variants(results), []
    for (_, protocol, budget, name), seeds in groups.items():
        cells = []
        for column in columns:
            values = [result.scores[column] for result in seeds if column in result.scores]
            reason = seeds[0].left_out.get(column, f"{protocol} has no such score")
            cells.append(spread(values, column) if values else f"–{notes.mark(reason)}")
        rows.append([name, protocol, budget, str(len(seeds)), *cells])
    lines += table(["method", "protocol", "budget", "seeds", *(COLUMNS[column].heading for column in columns)], rows,
                   left=3)
    lines += ["", "| aim | of | reached |", "| :--- | :--- | :--- |"]
    blurred = {key: float(np.mean([result.scores["across_blurred_psnr"] for result in seeds]))
               for key, seeds in groups.items() if all("across_blurred_psnr" in result.scores for result in seeds)}
    for key, seeds in groups.items():
        for column, most in AIMS.items():
            values = [result.scores[column] for result in seeds if column in result.scores]
            if values:
                lines.append(f"| {COLUMNS[column].label} at most {most:g} % ({key[1]}) | {key[3]} | "
                             f"{np.mean(values):.1f} %: {'' if np.mean(values) <= most else 'not '}reached |")
        without = [value for other, value in blurred.items()
                   if other[:3] == key[:3] and "unscaled_psnr" not in groups[other][0].scores]
        if without and key in blurred and "unscaled_psnr" in seeds[0].scores:
            ahead = blurred[key] - max(without)
            lines.append(f"| {AHEAD:g} dB above a method without a lens where the training photographs are blurred | "
                         f"{key[3]} | {ahead:+.2f} dB: {'' if ahead >= AHEAD else 'not '}reached |")
    return "\n".join([*lines, "", *notes.lines()]) + "\n"


def main(settings: Settings) -> None:
    """Read the runs and write both files."""
    found = [read_result(file) for file in sorted(settings.results.rglob(RESULT_FILE))]
    good = [result for result in found if result.status is Status.OK
            and any(column in result.scores for column in (*ACROSS_COLUMNS, *EXIF_COLUMNS))]
    write_csv(settings.out / "across-apertures.csv", FIELDS, [row_of(result) for result in good])
    write_text(settings.out / "across-apertures.md", markdown(good))


if __name__ == "__main__":
    main(tyro.cli(Settings))
