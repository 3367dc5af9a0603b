"""Sizes of the calls that `gpu_measure.py` times, counted on the CPU from their own inputs: call_sizes.csv.

    python benchmarks/gpu_call_sizes.py --out reports/gpu

With them the model predicts times of these very calls. Nothing here needs a GPU, and no time is measured.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from types import ModuleType

import gpu_calls
import numpy as np
import torch
import tyro
from dofbench.kernels.field.reference import LEAST_TRANSMITTANCE
from dofbench.kernels.rasterize import cpu, cpu_points
from gpu_calls import CALLS, Size
from gpu_field_samples import Samples, row
from gpu_footprints import drawn
from gpu_ops import Call
from gpu_scatter_windows import reach_of
from gpu_sizes import LENS_POINTS, Sizes
from gpu_sizes_field import FieldSizes
from gpu_sizes_stereo import StereoSizes

from dofbench.learning.priors.stereo import SOURCES
from dofbench.reporting.csv_writer import write_csv

FILE = "call_sizes.csv"
COLUMNS = ("op", "quantity", "value")
TILE = 32, 8  # pixels, of the scatter
THE_CALL = "every op"  # whose quantities are those of `Size`


@dataclass(frozen=True)
class Settings:
    """What is counted."""

    out: Path
    """Folder for call_sizes.csv."""
    size: Size = Size()
    """Of the calls."""


def main(settings: Settings) -> None:
    """Count and write."""
    rows = [(THE_CALL, name, value) for name, value in asdict(settings.size).items()]
    for op, count in COUNTED.items():
        rows += [(op, name, value) for name, value in count(settings.size).items()]
    write_csv(settings.out / FILE, COLUMNS, [dict(zip(COLUMNS, one, strict=True)) for one in rows])


def model_calls(op: str, size: Size, folder: Path) -> tuple[Call, ...]:
    """What the model takes for an op of `gpu_calls.CALLS`; nothing where its sizes aren't known for calls of this size.
    folder: of call_sizes.csv."""
    if op == "stereo":
        view = StereoSizes(op, size.width, size.height, size.planes, SOURCES)
        return Call(op, view, backward=False), Call("stereo_semiglobal", view, backward=False)
    if op not in COUNTED:
        return (Call(op, Sizes(op, size.gaussians, size.width, size.height)),)
    known = _read(folder / FILE)
    if known[THE_CALL] != asdict(size):
        return ()
    if op == "field":
        return (Call(op, FieldSizes(op, size.rays, size.nodes, size.samples, **known[op])),)
    points = LENS_POINTS if op == "rasterize_from_points" else 1
    return (Call(op, Sizes(op, size.gaussians, size.width, size.height, points=points, **known[op])),)


def _read(file: Path) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    with file.open(encoding="utf-8") as stream:
        for one in csv.DictReader(stream):
            found.setdefault(one["op"], {})[one["quantity"]] = float(one["value"])
    return found


def footprints(op: str, module: ModuleType) -> Callable[[Size], dict[str, float]]:
    """How the Gaussians of a call meet tiles, over the points that they are seen from. module: that lists them."""

    def counted(size: Size) -> dict[str, float]:
        call, camera = CALLS[op](size), gpu_calls.gaussians(size)[1]
        with torch.no_grad():
            found = list(drawn(lambda: call.run(*call.inputs), camera, module))
        return {name: float(np.mean([one[name] for one in found])) for name in found[0]}

    return counted


def largest_radii(size: Size) -> dict[str, float]:
    """Of the scatter: the mean over its tiles of the largest radius that reaches them."""
    radius = gpu_calls.scatter(size).inputs[1].abs().double().numpy()
    reach = np.vectorize(reach_of)(radius)
    row, column = np.mgrid[: size.height, : size.width]
    found = []
    for top, left in _corners(size):
        below = np.maximum(np.maximum(top - row, row - (top + TILE[1] - 1)), 0)
        beside = np.maximum(np.maximum(left - column, column - (left + TILE[0] - 1)), 0)
        found.append(radius[np.hypot(below, beside) <= reach].max())
    return {"radius": float(np.mean(found))}


def _corners(size: Size) -> Iterator[tuple[int, int]]:
    return product(range(0, size.height, TILE[1]), range(0, size.width, TILE[0]))


@torch.no_grad()
def field_samples(size: Size) -> dict[str, float]:
    """How the samples of a field's rays crowd in its cells, and how many of them are looked at and lit."""
    rays = gpu_calls.field_rays(size)
    points = rays.origins[:, None] + rays.places[:, None] * rays.directions[:, None]
    optical = rays.density(points.view(-1, 3)).view(points.shape[:2]).double() * rays.length
    looked_at = (optical - optical.cumsum(1)).exp() >= LEAST_TRANSMITTANCE
    mask = looked_at.view(-1).numpy()
    samples = Samples(np.full(size.rays, size.samples), points.view(-1, 3).numpy(), mask, mask)
    counted = asdict(row("samples", samples, size.samples, size.nodes))
    return {name: counted[name] for name in counted if name not in ("kind", "rays", "nodes", "steps")}


COUNTED: dict[str, Callable[[Size], dict[str, float]]] = {
    "rasterize": footprints("rasterize", cpu),
    "rasterize_from_points": footprints("rasterize_from_points", cpu_points),
    "scatter": largest_radii,
    "field": field_samples,
}

if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
