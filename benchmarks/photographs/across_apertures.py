"""Scores of finished runs, compared with their aims: photographs of one aperture predicted from those of another, and
learned apertures against EXIF. Writes across-apertures.csv and across-apertures.md.

    dofbench make-dataset SCENES/shallow_blowtorch --photographs shallow --layout colmap --width 530 \\
        --train-f-number 6.3 --test-f-number 14 --out data/across
    dofbench run --method dofgaussian,mipsplatting --data data/across --budget 1500it --seeds 3 --out results
    python -m benchmarks.photographs.across_apertures --results results --out reports/photographs
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from dofbench.core.errors import Status
from dofbench.core.files import write_text
from dofbench.evaluation.metrics.exif_errors import exif_errors
from dofbench.evaluation.results.collecting import Entry, collect, grouped, variant_names
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.protocol import ACROSS_COLUMNS, EXIF_COLUMNS
from dofbench.reporting.csv_writer import write_csv
from dofbench.reporting.footnotes import Footnotes
from dofbench.reporting.markdown_writer import markdown_table

FIELDS = (
    "method",
    "options",
    "budget",
    "seed",
    "protocol",
    "dataset_checksum",
    *ACROSS_COLUMNS,
    *EXIF_COLUMNS,
    "exif_deviation",
    "train_s",
    "fit_s",
    "key",
)
AIMS = {"exif_spread": 15.0, "exif_ratio": 10.0}  # largest values that reach the aim, per cent
AHEAD = 2.0  # dB by which a method with a lens is to exceed one without, in the column BLURRED
BLURRED = "across_blurred_psnr"
Key = tuple[str, ...]


@dataclass(frozen=True)
class Settings:
    """Which runs to read, and where to write."""

    results: Path
    """Folder of results."""
    out: Path
    """Folder for across-apertures.csv and across-apertures.md."""


def row_of(entry: Entry, options: str) -> dict[str, object]:
    """The CSV row of one run. exif_deviation: sample standard deviation over mean, per cent, in addition to the robust
    spread."""
    spec, result = entry.spec, entry.result
    errors = exif_errors([(view.aperture, view.f_number) for view in result.apertures])
    return {
        **{name: getattr(spec, name) for name in ("method", "budget", "seed", "protocol")},
        "options": options,
        "dataset_checksum": spec.dataset_checksum[:16],
        "key": result.key[:8],
        "exif_deviation": errors.deviation,
        "fit_s": sum(fit.seconds for fit in result.fits),
        **result.scores,
    }


def markdown(boards: dict[Key, dict[str, list[Entry]]]) -> str:
    """The tables of means over seeds, and which aims were reached. boards: board of comparable runs -> variant -> its
    seeds."""
    notes = Footnotes()
    lines = [
        "# One aperture predicted from another, and apertures against EXIF",
        "",
        "Written by `benchmarks/photographs/across_apertures.py`, whose head has the commands. Mean ± standard "
        "deviation over seeds.",
        "",
    ]
    rows, aims = [], ["", "| aim | of | reached |", "| :--- | :--- | :--- |"]
    for (_, _, protocol), variants in boards.items():
        for name, seeds in variants.items():
            cells = [
                _spread(seeds, column)
                if column in seeds[0].scores
                else f"–[^{notes.number(seeds[0].left_out.get(column, f'{protocol} has no such score'))}]"
                for column in (*ACROSS_COLUMNS, *EXIF_COLUMNS)
            ]
            rows.append([name, protocol, seeds[0].spec.budget, str(len(seeds)), *cells])
            for column, most in AIMS.items():
                if column in seeds[0].scores:
                    aims.append(
                        _aim(
                            f"{COLUMNS[column].label} at most {most:g} % ({protocol})",
                            name,
                            f"{_mean(seeds, column):.1f} %",
                            _mean(seeds, column) <= most,
                        )
                    )
            without = [
                _mean(other, BLURRED)
                for other in variants.values()
                if BLURRED in other[0].scores
                and "unscaled_psnr" not in other[0].scores
                and other[0].spec.budget == seeds[0].spec.budget
            ]
            if without and "unscaled_psnr" in seeds[0].scores:
                ahead = _mean(seeds, BLURRED) - max(without)
                aims.append(
                    _aim(
                        f"{AHEAD:g} dB above any method without a lens where training photographs are blurred",
                        name,
                        f"{ahead:+.2f} dB",
                        ahead >= AHEAD,
                    )
                )
    headings = [COLUMNS[column].heading for column in (*ACROSS_COLUMNS, *EXIF_COLUMNS)]
    lines += markdown_table(["method", "protocol", "budget", "seeds", *headings], rows, left=3)
    return "\n".join([*lines, *aims, "", *(f"[^{number}]: {reason}" for number, reason in notes.reasons())]) + "\n"


def _mean(seeds: list[Entry], column: str) -> float:
    return float(np.mean([entry.scores[column] for entry in seeds]))


def _spread(seeds: list[Entry], column: str) -> str:
    text, values = COLUMNS[column].text, [entry.scores[column] for entry in seeds]
    mean = text(float(np.mean(values)))
    return mean if len(values) < 2 else f"{mean} ± {text(float(np.std(values, ddof=1)))}"


def _aim(aim: str, name: str, found: str, reached: bool) -> str:
    return f"| {aim} | {name} | {found}: {'' if reached else 'not '}reached |"


def main(settings: Settings) -> None:
    """Read the runs and write both files."""
    entries = collect(settings.results).entries
    names = {variant: " ".join(words) for variant, words in variant_names(entries).items()}
    scored = [
        entry
        for entry in entries
        if entry.status is Status.OK and any(column in entry.scores for column in (*ACROSS_COLUMNS, *EXIF_COLUMNS))
    ]
    boards = {
        board: {names[variant]: seeds for variant, seeds in grouped(members, "variant").items()}
        for board, members in grouped(scored, "board").items()
    }
    write_csv(settings.out / "across-apertures.csv", FIELDS, [row_of(entry, names[entry.variant]) for entry in scored])
    write_text(settings.out / "across-apertures.md", markdown(boards))


if __name__ == "__main__":
    main(tyro.cli(Settings))
