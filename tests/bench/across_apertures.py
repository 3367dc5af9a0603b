"""Photographs of one aperture predicted from those of another, and learned apertures against EXIF, beside their aims:
across-apertures.csv and across-apertures.md, of finished runs.

    dofbench make-dataset SCENES/shallow_blowtorch --photographs shallow --width 265 \\
        --train-f-number 6.3 --test-f-number 14 --out data/blowtorch
    dofbench run --method dofgaussian --data data/blowtorch --force-all --out results
    dofbench run --method mipsplatting --data data/blowtorch --out results
    python tests/bench/across_apertures.py --results results --out reports/photographs
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dofbench.errors import Status
from dofbench.files import write_text
from dofbench.harness.protocol import ACROSS_COLUMNS, EXIF_COLUMNS
from dofbench.harness.result import RESULT_FILE, Result, read_result
from dofbench.metrics.exif_errors import exif_errors
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.tables import write_csv

FIELDS = ("method", "preset", "budget", "seed", "protocol", "dataset_checksum", *ACROSS_COLUMNS, *EXIF_COLUMNS,
          "exif_deviation", "train_s", "fit_s", "key")
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
        "dataset_checksum": spec.dataset_checksum[:16], "key": result.key[:8], "exif_deviation": errors.deviation,
        "fit_s": sum(fit.seconds for fit in result.fits), **result.scores,
    }


def markdown(results: list[Result]) -> str:
    """The tables, and how far the aims were reached."""
    notes = Footnotes()
    lines = ["# One aperture predicted from another, and apertures against EXIF", "",
             "Written by `tests/bench/across_apertures.py`, whose head has the commands.", ""]
    columns = (*ACROSS_COLUMNS, *EXIF_COLUMNS)
    rows = []
    for result in results:
        cells = [COLUMNS[column].text(result.scores[column]) if column in result.scores
                 else f"–{notes.mark(result.left_out.get(column, f'{result.spec.protocol} has no such score'))}"
                 for column in columns]
        rows.append([result.spec.method, result.spec.protocol, result.spec.budget, *cells])
    lines += table(["method", "protocol", "budget", *(COLUMNS[column].heading for column in columns)], rows, left=3)
    lines += ["", "| aim | reached |", "| :--- | :--- |"]
    without = [result.scores["across_blurred_psnr"] for result in results
               if "across_blurred_psnr" in result.scores and "unscaled_psnr" not in result.scores]
    for result in results:
        for column, most in AIMS.items():
            if (value := result.scores.get(column)) is not None:
                lines.append(f"| {COLUMNS[column].label} at most {most:g} % ({result.spec.protocol}) | {value:.1f} %: "
                             f"{'reached' if value <= most else 'not reached'} |")
        if without and "unscaled_psnr" in result.scores and "across_blurred_psnr" in result.scores:
            ahead = result.scores["across_blurred_psnr"] - max(without)
            lines.append(f"| {AHEAD:g} dB above a method without a lens where the training photographs are blurred | "
                         f"{ahead:+.2f} dB: {'reached' if ahead >= AHEAD else 'not reached'} |")
    return "\n".join([*lines, "", *notes.lines()]) + "\n"


def main(settings: Settings) -> None:
    """Read the runs and write both files."""
    found = [read_result(file) for file in sorted(settings.results.rglob(RESULT_FILE))]
    good = [result for result in found if result.status is Status.OK]
    write_csv(settings.out / "across-apertures.csv", FIELDS, [row_of(result) for result in good])
    write_text(settings.out / "across-apertures.md", markdown(good))


if __name__ == "__main__":
    main(tyro.cli(Settings))
