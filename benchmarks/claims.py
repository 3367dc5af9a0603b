"""Whether each method that learns a blur beats its plain version on a scene of that blur: claims.csv.

    python benchmarks/claims.py --out reports/notes --seeds 3

The scene, the blurs and the options are those of the test (`tests/blurred_tabletop.py`): the built-in scene, 96 pixels
wide, 500 steps. psnr: all in focus, views held back, dB; cpu_s: seconds of processor time for training.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from dofbench.compute.threads import configure_threads

configure_threads()  # before torch is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from blurred_tabletop import CLAIMS, STEPS, UNSURE, sharp_psnr, tabletop, trained  # noqa: E402

from dofbench.reporting.csv_writer import write_csv  # noqa: E402


@dataclass(frozen=True)
class Settings:
    """What to run."""

    out: Path
    """Folder for claims.csv."""
    seeds: int = 3
    """Trainings of each."""


def main(settings: Settings) -> None:
    """Train everything, and write the table after each training."""
    plain: list[tuple[str, str, dict[str, float]]] = []
    claims = (*CLAIMS, *UNSURE)
    for _, method, blur, _ in claims:
        if (method, blur, {}) not in plain:
            plain.append((method, blur, {}))
    rows: list[dict[str, object]] = []
    for method, blur, options in [*plain, *((method, blur, options) for method, _, blur, options in claims)]:
        for seed in range(settings.seeds):
            begun = time.process_time()
            made = trained(method, tabletop(blur), STEPS, seed, **options)
            seconds = time.process_time() - begun
            psnr = sharp_psnr(made, tabletop(blur))
            rows.append(
                {
                    "method": method,
                    "blur": blur,
                    "options": " ".join(f"{name}={value:g}" for name, value in options.items()),
                    "seed": seed,
                    "psnr": f"{psnr:.2f}",
                    "cpu_s": f"{seconds:.0f}",
                }
            )
            print(rows[-1], flush=True)
            write_csv(settings.out / "claims.csv", tuple(rows[0]), rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
