"""All-in-focus renderings where the photograph is in focus: python -m benchmarks.boards.in_focus RUNS FILE

A photograph with a shallow depth of field shows only a part of its scene sharply, and only there it says whether an
all-in-focus rendering is right. Here that is the third of the scored pixels with the most energy in the finest band, by
the photograph alone. Colours are fitted on the other half of its tiles, as for every score of photographs. In-focus
surfaces without texture aren't in it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dofbench.core.errors import Status
from dofbench.core.files import write_csv
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.scoring.photograph_scores import true_photograph
from dofbench.evaluation.scoring.photographs.band_energies import BANDS, band_energy
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr
from dofbench.evaluation.scoring.photographs.predict import recoloured_by
from dofbench.running.load_run import load_run

SHARE = 1 / 3  # of the scored pixels


def in_focus(photograph: np.ndarray, tiles: Tiles) -> np.ndarray:
    """(H, W) bool: the scored pixels where the photograph has most detail. photograph: (H, W, 3), encoded."""
    energy = band_energy(photograph, BANDS[0], tiles)
    return tiles.scored & (energy >= np.quantile(energy[tiles.scored], 1 - SHARE))


def main(runs: Path, file: Path) -> None:
    """Write a row for each test view of each run."""
    rows = []
    for entry in collect(runs).entries:
        if entry.status is not Status.OK:
            continue
        run = load_run(entry.folder)
        for view in run.dataset.test_views():
            photograph = true_photograph(run.dataset, view)
            tiles = Tiles.of(view.camera.height, view.camera.width, run.dataset.mask(view))
            image = recoloured_by(run.method.render(view.camera, None).image, photograph, tiles)
            spec = entry.spec
            who = {"method": spec.method, "preset": entry.preset, "dataset": spec.dataset, "seed": spec.seed}
            where = in_focus(photograph, tiles)
            rows.append({**who, "view": view.name, "in_focus_psnr": masked_psnr(image, photograph, where)})
    write_csv(file, list(rows[0]), rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
