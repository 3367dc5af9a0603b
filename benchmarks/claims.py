"""Whether each method that learns a blur beats its plain version on a scene of that blur: claims.csv.

    python benchmarks/claims.py --out reports/notes --seeds 3

The scene, the blurs, the options and the numbers of steps are those of the test (`tests/blurred_tabletop.py`): the
built-in scene, 96 pixels wide. psnr: all in focus, views held back, dB; cpu_s: seconds of processor time for training.
What the table has already is left out, so the same call goes on where another one ended.
"""

from __future__ import annotations

import csv
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from dofbench.compute.threads import configure_threads

configure_threads()  # before torch is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from blurred_tabletop import CLAIMS, Claim, sharp_psnr, tabletop, trained  # noqa: E402

from dofbench.reporting.csv_writer import write_csv  # noqa: E402


@dataclass(frozen=True)
class Settings:
    """What to run."""

    out: Path
    """Folder for claims.csv."""
    seeds: int = 3
    """Trainings of each."""


def main(settings: Settings) -> None:
    """Train everything that the table lacks, and write it after each training."""
    plain: list[Claim] = []
    for claim in CLAIMS:
        if (one := Claim(claim.plain, claim.plain, claim.blur, steps=claim.steps)) not in plain:
            plain.append(one)
    file = settings.out / "claims.csv"
    rows = list(csv.DictReader(file.open(encoding="utf-8"))) if file.is_file() else []
    for claim in [*plain, *CLAIMS]:
        options = " ".join(f"{name}={value:g}" for name, value in claim.options.items())
        for seed in range(settings.seeds):
            key = {
                "method": claim.method,
                "blur": claim.blur,
                "options": options,
                "steps": str(claim.steps),
                "seed": str(seed),
            }
            if any(key.items() <= row.items() for row in rows):
                continue
            begun = time.process_time()
            made = trained(claim.method, tabletop(claim.blur), claim.steps, seed, **claim.options)
            seconds = time.process_time() - begun
            psnr = sharp_psnr(made, tabletop(claim.blur))
            rows.append({**key, "psnr": f"{psnr:.2f}", "cpu_s": f"{seconds:.0f}"})
            print(rows[-1], flush=True)
            write_csv(file, tuple(rows[0]), rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
