"""Which photographs determine their aperture? Known lenses on the built-in scene, measured with its exact depth.

    python -m benchmarks.lens.measured --data data/fern data/foliage data/chess --out reports/lens/measured.csv

The same for datasets of known lenses and depth. Prints a Markdown table: what is photographed how, the measured
aperture over the true one with its interval of 68 %, and the mean errors of the views' apertures and foci. What isn't
determined has its interval alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from dofbench.core.content import content_folder
from dofbench.core.files import write_csv
from dofbench.core.lens import COC_FRACTION, GAMMA, DisparityRange, Lens
from dofbench.datasets.format.dataset import Dataset
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.tone import decode, encode
from dofbench.scenes import load_scene
from dofbench.training.common.blur_pairs import Surface, blur_pairs
from dofbench.training.common.lens_profile import MeasuredLenses, measure_lenses
from dofbench.training.common.lenses import Ties

WIDTH = 160  # px; a radius of 3.2 px at aperture 1, a whole range from the focus
COLUMNS = ["photographs", "aperture", "measured", "low", "high", "aperture_error", "focus_error", "patches"]


@dataclass(frozen=True)
class Taken:
    """How photographs are taken. foci: in turn. every: of the scene's 20 views. sharp: every so many is stopped down;
    0 for none. stops: largest error of exposure. noise: standard deviation, levels of 255."""

    foci: Sequence[float] = (0.2, 0.5, 0.8)
    every: int = 1
    sharp: int = 0
    stops: float = 0.0
    noise: float = 0.0


CONDITIONS = {
    "20, focused on three planes": Taken(),
    "20, on five planes": Taken((0.1, 0.3, 0.5, 0.7, 0.9)),
    "20, on two planes": Taken((0.2, 0.8)),
    "20, all on the middle": Taken((0.5,)),
    "20, all in front": Taken((1.2,)),
    "20, all in front, every fifth stopped down to a tenth": Taken((1.2,), sharp=5),
    "20, three planes, every fifth stopped down to a tenth": Taken(sharp=5),
    "10, three planes, twice as far apart": Taken(every=2),
    "7, three planes, three times as far apart": Taken(every=3),
    "5, three planes, four times as far apart": Taken(every=4),
    "20, three planes, exposure off by up to half a stop": Taken(stops=0.5),
    "20, three planes, noise of 4 levels": Taken(noise=4.0),
}


def measured(taken: Taken, aperture: float) -> dict[str, str]:
    """A row of the table but for its name."""
    scene, random = load_scene(content_folder("datasets") / "tabletop", width=WIDTH), np.random.default_rng(0)
    bounds = DisparityRange.of(np.stack([view.depth() for view in scene.views]))
    surfaces, foci, openings = [], [], []
    for number, view in enumerate(scene.views[:: taken.every]):
        focus = taken.foci[number % len(taken.foci)]
        opening = 0.1 if taken.sharp and number % taken.sharp == 0 else 1.0
        depth, lens = view.depth(), Lens(opening * aperture, focus).physical(bounds, WIDTH)
        image = defocus_numpy(view.image().astype(np.float32), depth, lens)[0].clip(0, 1)
        image = encode(decode(image) * 2.0 ** -random.uniform(0, taken.stops))
        image = (image + random.normal(0, taken.noise / 255, image.shape)).clip(0, 1)
        surfaces.append(Surface.of(view.camera, image.astype(np.float32), depth, None, GAMMA))
        foci.append(focus)
        openings.append(opening)
    # As EXIF's f-numbers would say.
    ties = Ties((0,) * len(foci), tuple(range(len(foci))), tuple(openings))
    found = measure_lenses(blur_pairs(surfaces, bounds.extent), bounds, ties, np.full(len(foci), WIDTH), 0)
    true = aperture * np.array(openings)
    return {"aperture": f"{aperture:g}", **_row(found, true, np.array(foci), float(np.median(true)))}


def measured_on(folder: Path) -> dict[str, str]:
    """A row for a dataset of known lenses and depth."""
    dataset = Dataset.load(folder)
    taken, views = dataset.training_set("shallow").views, dataset.training_views()
    depths = [dataset.depth(view) for view in views]
    bounds, widths = DisparityRange.of(np.stack(depths)), np.array([view.camera.width for view in taken])
    surfaces = [
        Surface.of(view.camera, view.image, depth, view.mask, GAMMA) for view, depth in zip(taken, depths, strict=True)
    ]
    lenses = [view.physical_lens for view in views]
    true = [one.aperture_at(1) * bounds.extent / COC_FRACTION for one in lenses]
    foci = np.array([bounds.normalise(one.focus_disparity) for one in lenses])
    found = measure_lenses(blur_pairs(surfaces, bounds.extent), bounds, Ties.untied(len(taken)), widths, 0)
    middle = float(np.median(true))
    return {
        "photographs": f"{len(taken)}, {folder.name}",
        "aperture": f"{middle:.2f}",
        **_row(found, true, foci, middle),
    }


def _row(found: MeasuredLenses | None, true: Any, foci: np.ndarray, middle: float) -> dict[str, str]:
    """true: (V,) apertures. middle: their median, to which the interval relates."""
    if found is None:
        return {}
    row = {"low": f"{found.low / middle:.2f}", "high": f"{found.high / middle:.2f}", "patches": str(found.patches)}
    if found.determined:
        row["measured"] = f"{np.median(found.aperture) / middle:.2f}"
        row["aperture_error"] = f"{np.mean(np.abs(found.aperture / true - 1)):.3f}"
        row["focus_error"] = f"{np.mean(np.abs(found.foci - foci)):.3f}"
    return row


def main(out: Path, data: tuple[Path, ...] = ()) -> None:
    """Measure all conditions at two apertures, and on datasets. out: a CSV. data: folders of datasets."""
    rows = [
        {"photographs": name, **measured(taken, aperture)}
        for name, taken in CONDITIONS.items()
        for aperture in (1.0, 2.0)
    ]
    rows += [measured_on(folder) for folder in data]
    write_csv(out, COLUMNS, rows)
    for row in rows:
        print("| " + " | ".join(row.get(column, "–") for column in COLUMNS) + " |")


if __name__ == "__main__":
    tyro.cli(main)
