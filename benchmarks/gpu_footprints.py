"""How Gaussians of a trained scene meet tiles of 16 x 16 pixels, by how many there are for each pixel: footprints.csv.

    python benchmarks/gpu_footprints.py --out reports/gpu

The built-in scene is trained on the CPU with as many Gaussians for each of its pixels as the workloads of
`gpu_model.py` have: a picture of theirs is then taken for one that is put together of many such small ones. Each
training view is drawn once more, and its tiles' lists are followed pixel by pixel. The figures are means over
every third view. Nothing here needs a GPU, and no time is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import tyro
from dofbench.kernels.rasterize import cpu
from dofbench.kernels.rasterize import cpu_layout as layout
from gpu_torch_calls import training_set
from unobserved import Unobserved

from dofbench.core.budget import Budget
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trainer import Trainer
from dofbench.reporting.csv_writer import write_csv

TILE, PROGRAM, TEST_EVERY = 16, 128, 16  # as gpu_layout.TILE, gpu_lists._GAUSSIANS and gpu_blend._TEST_EVERY
MAX_ALPHA, MIN_TRANSMITTANCE = 0.99, 1e-4


@dataclass(frozen=True)
class Settings:
    """Which scenes are trained, and how long."""

    out: Path
    """Folder for footprints.csv."""
    densities: tuple[float, ...] = (0.8, 1.3, 6.6)
    """Gaussians for each pixel."""
    width: int = 128
    """Of the pictures, pixels."""
    steps: int = 600
    """Of each training."""


@dataclass(frozen=True)
class Row:
    """Means over the views of one scene. per_pixel: Gaussians for each pixel. visible: share of the Gaussians that meet
    a pixel. intersections: tiles that a visible one meets. rows: rows of tiles that it meets. widest_rows: the same of
    the widest among 128 neighbours in memory, which one GPU program counts together. most_intersections: tiles that
    the widest of four neighbours in depth meets. longest_list: of a picture's tiles, over the mean. looked_at: share of
    a tile's list that is followed until the tile is opaque. taken: share of these that colour a pixel of the tile.
    """

    per_pixel: float
    gaussians: int
    pixels: int
    visible: float
    intersections: float
    rows: float
    widest_rows: float
    most_intersections: float
    longest_list: float
    looked_at: float
    taken: float


def main(settings: Settings) -> None:
    """Train a scene for each density, and write the table."""
    rows = [measured(density, settings) for density in settings.densities]
    names = tuple(field.name for field in fields(Row))
    write_csv(settings.out / "footprints.csv", names, [{name: getattr(row, name) for name in names} for row in rows])


def measured(density: float, settings: Settings) -> Row:
    """The figures of one trained scene."""
    data = training_set(settings.width)
    views = data.views
    pixels = views[0].camera.width * views[0].camera.height
    limit = round(density * pixels)
    options = GaussianOptions().with_overrides(
        {"lens": False, "max_gaussians": limit, "densify_from": 0.05, "densify_until": 0.6, "grow_gradient": 1e-5,
         "grow_absolute": True, "clone_opacity": "share", "reset_every": 0.0, "sh_degree": 3, "edge_weight": 4.0,
         "ssim_weight": 0.4, "densify_every": 20}
    )  # fmt: skip
    trainer = Trainer(data, options, 0)
    trainer.fit(Budget(steps=settings.steps), Unobserved())
    count = len(trainer.gaussians)
    found = [
        seen
        for view in views[::3]
        for seen in drawn(lambda view=view: trainer.render(view.camera, None), view.camera, cpu)
    ]
    means = {name: float(np.mean([one[name] for one in found])) for name in found[0]}
    print(f"{count} Gaussians, {count / pixels:.2f} a pixel: {means}", flush=True)
    return Row(per_pixel=count / pixels, gaussians=count, pixels=pixels, **means)


def drawn(draw: Callable[[], object], camera: Any, module: ModuleType) -> Iterator[dict[str, float]]:
    """What is to be known of each picture that `draw` draws. module: the CPU backend's, that lists the Gaussians of
    every tile."""
    caught: list[tuple[Any, ...]] = []
    fill = module.fill_tiles

    def caught_fill(*arguments: Any) -> Any:
        caught.append(arguments)
        return fill(*arguments)

    module.fill_tiles = caught_fill  # type: ignore[attr-defined]
    try:
        draw()
    finally:
        module.fill_tiles = fill  # type: ignore[attr-defined]
    for records, counts, n, order, *_ in caught:
        yield lists(records.reshape(-1, layout.RECORD)[:n], order, counts[:n] > 0, camera)


def lists(records: np.ndarray, order: np.ndarray, candidates: np.ndarray, camera: Any) -> dict[str, float]:
    """The figures of one view. records: (N, RECORD). order: Gaussians, nearest first. candidates: (N,), whether one
    can be seen."""
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    met = np.zeros((len(records), rows), int)
    entries: list[list[int]] = [[] for _ in range(columns * rows)]
    for row in range(rows):
        with np.errstate(invalid="ignore", divide="ignore"):  # of records of Gaussians that can't be seen
            first, many = columns_met(records, row, camera)
        met[:, row] = np.where(candidates, many, 0)
        for i in order:
            for column in range(first[i], first[i] + met[i, row]):
                entries[row * columns + column].append(i)
    total = met.sum(1)
    shown, high = total > 0, (met > 0).sum(1)
    by_depth = total[order]
    followed = [follow(records, ids, tile, columns, camera) for tile, ids in enumerate(entries)]
    looked, taken = np.sum(followed, axis=0)
    return {
        "visible": shown.mean(),
        "intersections": total[shown].mean(),
        "rows": high[shown].mean(),
        "widest_rows": np.pad(high, (0, -len(high) % PROGRAM)).reshape(-1, PROGRAM).max(1).mean(),
        "most_intersections": np.pad(by_depth, (0, -len(by_depth) % 4)).reshape(-1, 4).max(1).mean(),
        "longest_list": max(map(len, entries)) * len(entries) / total.sum(),
        "looked_at": looked / total.sum(),
        "taken": taken / looked,
    }


def columns_met(records: np.ndarray, row: int, camera: Any) -> tuple[np.ndarray, np.ndarray]:
    """The first tile that each Gaussian's ellipse meets in a row of tiles, and how many: `gpu_tiles.columns_met`
    without its margins for rounding. The box around an ellipse is to hold a pixel's centre."""
    mx, my, l11, l21, l22 = (
        records[:, k].astype(float) for k in (layout.MX, layout.MY, layout.L11, layout.L21, layout.L22)
    )
    reach2 = np.maximum(records[:, layout.LOG2_OPACITY].astype(float) - records[:, layout.LIMIT], 0.0)
    half = np.sqrt(reach2) / l22
    low = np.maximum(row * TILE + 0.5 - my, -half)
    high = np.minimum(min((row + 1) * TILE, camera.height) - 0.5 - my, half)
    turn = l21 * half / np.hypot(l21, l22)
    sides = []
    for sign in (-1.0, 1.0):
        at = np.minimum(np.maximum(-sign * turn, low), high)
        sides.append((-l21 * at + sign * np.sqrt(np.maximum(reach2 - (l22 * at) ** 2, 0.0))) / l11)
    first = np.maximum(np.ceil(mx + sides[0] - 0.5), 0.0)
    last = np.minimum(np.floor(mx + sides[1] - 0.5), camera.width - 1.0)
    meets = (low <= high) & (first <= last)
    first = np.where(meets, first, 0.0).astype(int) // TILE
    return first, np.where(meets, np.where(meets, last, 0.0).astype(int) // TILE - first + 1, 0)


def follow(records: np.ndarray, ids: list[int], tile: int, columns: int, camera: Any) -> tuple[int, int]:
    """How many Gaussians of a tile's list are looked at, and how many of them colour a pixel of the tile."""
    x = tile % columns * TILE + np.arange(TILE)[None, :] + 0.5
    y = tile // columns * TILE + np.arange(TILE)[:, None] + 0.5
    inside = (x < camera.width) & (y < camera.height)
    left = np.where(inside, 1.0, 0.0)
    looked = taken = 0
    for i in ids:
        record = records[i]
        dx, dy = x - record[layout.MX], y - record[layout.MY]
        d, e = record[layout.L11] * dx + record[layout.L21] * dy, record[layout.L22] * dy
        exponent = record[layout.LOG2_OPACITY] - d * d - e * e
        counts = (exponent >= record[layout.LIMIT]) & (left >= MIN_TRANSMITTANCE)
        left = left * np.where(counts, 1.0 - np.minimum(np.exp2(exponent), MAX_ALPHA), 1.0)
        looked, taken = looked + 1, taken + bool(counts.any())
        if looked % TEST_EVERY == 0 and left.max() < MIN_TRANSMITTANCE:
            break
    return looked, taken


if __name__ == "__main__":
    main(tyro.cli(Settings))
