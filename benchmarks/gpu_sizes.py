"""Sizes of the workloads that `gpu_model.py` predicts times of."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

TILE = 16  # pixels, of the rasteriser's tiles
ALPHA = 4.0  # steepness of the scatter's rim, dofbench.core.lens.ALPHA
_BAND, _FOCUS = 12.0, 18.0  # how far sources are followed, kernels/scatter/gpu_direct.py


@dataclass(frozen=True)
class Sizes:
    """What the time of a training step or a picture depends on.

    gaussians: how many there are. visible: share of them that meet a pixel. width, height: pixels. intersections: tiles
    that a visible Gaussian meets. rows: rows of tiles that it meets. widest_rows: the same of the widest of 128
    neighbours in memory. most_intersections: tiles that the widest of four neighbours in depth meets. longest_list: of
    the tiles' lists, over the mean. looked_at: share of the lists that is followed. taken: share of these whose
    Gaussian colours a pixel of the tile. terms: spherical harmonics of each Gaussian beyond the first. radius: mean
    over the scatter's tiles of the largest radius that reaches them, pixels. torch_ops: torch's own small operations in
    a training step.
    """

    name: str
    gaussians: int
    width: int
    height: int
    visible: float = 1.0
    intersections: float = 2.0
    rows: float = 1.5
    widest_rows: float = 3.0
    most_intersections: float = 3.0
    longest_list: float = 1.0
    looked_at: float = 1.0
    taken: float = 1.0
    terms: int = 15
    radius: float = 4.0
    torch_ops: int = 0

    @property
    def pixels(self) -> int:
        """Of the picture."""
        return self.width * self.height

    @property
    def numbers(self) -> int:
        """Of the picture's three colours."""
        return 3 * self.pixels

    @property
    def tiles(self) -> int:
        """Of the rasteriser, all of the picture's."""
        return math.ceil(self.width / TILE) * math.ceil(self.height / TILE)

    @property
    def seen(self) -> float:
        """Gaussians that are visible."""
        return self.visible * self.gaussians

    @property
    def pairs(self) -> float:
        """Intersections of Gaussians with tiles, all lists together."""
        return self.seen * self.intersections

    @property
    def followed(self) -> float:
        """Intersections that blending looks at."""
        return self.looked_at * self.pairs

    @property
    def scatter_tiles(self) -> int:
        """Tiles of the scatter, 32 x 8 pixels."""
        return math.ceil(self.width / 32) * math.ceil(self.height / 8)

    @property
    def reach(self) -> int:
        """How far the scatter follows a source, whole pixels."""
        return math.ceil(max(self.radius + _BAND / (2 * ALPHA), _FOCUS / (2 * ALPHA)))

    @cached_property
    def offsets(self) -> int:
        """Places around a pixel that the direct scatter visits."""
        far = self.reach
        return sum(2 * (math.isqrt(far * far - dy * dy) + 1) + 1 for dy in range(-far, far + 1))


def workloads(folder: Path) -> tuple[Sizes, ...]:
    """The three workloads. folder: of footprints.csv, which `gpu_footprints.py` measured on the CPU."""
    with (folder / "footprints.csv").open(encoding="utf-8") as stream:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    given = (("fern", 150_000, 504, 378), ("rendered", 1_000_000, 1008, 756), ("large", 5_000_000, 1008, 756))
    return tuple(_like(rows, *one) for one in given)


def _like(rows: list[dict[str, float]], name: str, gaussians: int, width: int, height: int) -> Sizes:
    """A workload with the footprints of the scene that has the most similar number of Gaussians for each pixel."""
    wanted = gaussians / (width * height)
    row = min(rows, key=lambda one: abs(math.log(one["per_pixel"] / wanted)))
    means = (
        "visible",
        "intersections",
        "rows",
        "widest_rows",
        "most_intersections",
        "longest_list",
        "looked_at",
        "taken",
    )
    return Sizes(name, gaussians, width, height, **{key: row[key] for key in means}, torch_ops=int(row["torch_ops"]))
