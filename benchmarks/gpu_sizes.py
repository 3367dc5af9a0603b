"""Sizes of the workloads with Gaussians and pictures that `gpu_model.py` predicts times of; those of the others are in
`gpu_sizes_field.py` and `gpu_sizes_stereo.py`."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from gpu_scatter_windows import Windows, reach_of, windows

TILE = 16  # pixels, of the rasteriser's tiles
LENS_POINTS = 5  # that the preset `thinlens` draws a picture from, dofbench/gaussians/forward/lens_pattern.py


@dataclass(frozen=True)
class Sizes:
    """What the time of a training step or a picture depends on.

    gaussians: how many there are. visible: share of them that meet a pixel. width, height: pixels. intersections: tiles
    that a visible Gaussian meets. rows: rows of tiles that it meets. widest_rows: the same of the widest of 128
    neighbours in memory. most_intersections: tiles that the widest of four neighbours in depth meets. longest_list: of
    the tiles' lists, over the mean. looked_at: share of the lists that is followed. taken: share of these whose
    Gaussian colours a pixel of the tile. terms: spherical harmonics of each Gaussian beyond the first. points: of
    the lens, from each of which a picture is drawn. radius: mean over the scatter's tiles of the largest radius that
    reaches them, pixels. torch_ops: torch's own small operations in a training step.
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
    points: int = 1
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
        """Of the rasteriser, all of the picture's, from all points of the lens."""
        return self.points * math.ceil(self.width / TILE) * math.ceil(self.height / TILE)

    @property
    def seen(self) -> float:
        """Gaussians that are visible."""
        return self.visible * self.gaussians

    @property
    def pairs(self) -> float:
        """Intersections of Gaussians with tiles, all lists together."""
        return self.points * self.seen * self.intersections

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
        return reach_of(self.radius)

    @cached_property
    def offsets(self) -> int:
        """Places around a pixel that the direct scatter visits."""
        far = self.reach
        return sum(2 * (math.isqrt(far * far - dy * dy) + 1) + 1 for dy in range(-far, far + 1))

    @property
    def disc(self) -> Windows:
        """Windows of the linear scatter, of a tile whose sources are discs of this radius."""
        return windows(self.radius, 0)

    @property
    def polygon(self) -> Windows:
        """The same of hexagons."""
        return windows(self.radius, 6)


def workloads(folder: Path) -> tuple[Sizes, ...]:
    """The three trainings. folder: of footprints.csv and torch_calls.csv, which were measured on the CPU."""
    rows = [{key: float(value) for key, value in row.items()} for row in _rows(folder / "footprints.csv")]
    calls = torch_calls(folder)["scatter"]
    given = (("fern", 150_000, 504, 378), ("rendered", 1_000_000, 1008, 756), ("large", 5_000_000, 1008, 756))
    return tuple(replace(_like(rows, *one), torch_ops=calls) for one in given)


def from_points(sizes: Sizes, folder: Path) -> Sizes:
    """A training whose pictures are drawn from points of the lens. Each Gaussian is taken to meet as many tiles as it
    does without its blur, which is no more than 0.3 of its circle of confusion."""
    return replace(sizes, points=LENS_POINTS, torch_ops=torch_calls(folder)["points"])


def torch_calls(folder: Path) -> dict[str, int]:
    """torch_calls.csv: of a training step, by the kind of training."""
    return {row["training"]: int(row["calls"]) for row in _rows(folder / "torch_calls.csv")}


def _rows(file: Path) -> Iterable[dict[str, str]]:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


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
    return Sizes(name, gaussians, width, height, **{key: row[key] for key in means})
