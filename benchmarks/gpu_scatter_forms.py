"""Which form of the scatter would be faster on a GPU, by instructions of the compiled kernels: gpu-scatter.csv.

    python benchmarks/gpu_scatter_forms.py --out reports/notes

No GPU is needed and nothing is run. The kernels for discs are compiled for an H100, and its disassembler tells how
many instructions each loop has. How often each loop is gone through follows from radii and tiles as in the kernels. A
time is the number of instructions over what an H100 issues at its boost clock: what it would take if nothing ever
waited for memory. Whatever a loop's body holds is counted whenever the body is entered, though branches leave some of
it out, so that the linear form is charged too much rather than too little.

`even`: one radius everywhere. `ramp`: from -R at the left border to R at the right one. `noise`: neighbours have
nothing in common, and every window has to be gone through pixel by pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gpu_kernels
import numpy as np
import tyro
from gpu_code import listing
from gpu_peaks import GPUS
from gpu_sass import parts
from gpu_scatter_windows import BAND, COARSE, FINE, FOCUS

from dofbench.reporting.csv_writer import write_csv

H100 = GPUS[1]
ISSUED = H100.multiprocessors * H100.issue * H100.clock  # instructions of warps a second
TILE_Y, TILE_X, WARPS = 8, 32, 4
KERNELS = {"forward": ("gather", "gather_windows"), "backward": ("gather_gradient", "gather_gradient_windows")}


@dataclass(frozen=True)
class Settings:
    """Where the table goes, and for which pictures."""

    out: Path
    """Folder for gpu-scatter.csv."""
    widths: tuple[int, ...] = (504, 1008)
    """Of pictures of four by three."""
    radii: tuple[int, ...] = (2, 4, 8, 12, 16, 24, 40, 80)
    """R, pixels."""


def main(settings: Settings) -> None:
    """Count and write."""
    rows = []
    bodies = loops()
    for width in settings.widths:
        height = width * 3 // 4
        for radius in settings.radii:
            row: dict[str, Any] = {"width": width, "r": radius}
            for scene in ("even", "ramp", "noise"):
                for way, (direct, linear) in KERNELS.items():
                    times = milliseconds(bodies[direct], bodies[linear], width, height, scene, radius, way)
                    row |= {f"{scene}_{way}_direct_ms": times[0], f"{scene}_{way}_linear_ms": times[1]}
            rows.append(row)
    settings.out.mkdir(parents=True, exist_ok=True)
    write_csv(settings.out / "gpu-scatter.csv", tuple(rows[0]), rows)


def loops() -> dict[str, list[int]]:
    """For each kernel of discs with the area term the instructions of its loops, innermost first, each without those of
    the loops in it."""
    found = {}
    names = {name for both in KERNELS.values() for name in both}
    for launch in gpu_kernels.launches():
        constants = dict(launch["constants"])
        plain = launch["function"] in names and not constants["SHAPED"] and not constants["STOPPED"]
        if plain and constants.get("AREA", True):
            found[launch["function"]] = bodies_of(gpu_kernels.binary_of(launch, H100.architecture).asm["cubin"])
    return found


def bodies_of(cubin: bytes) -> list[int]:
    """Instructions of nested loops, innermost first."""
    return [len(part.instructions) for part in reversed(parts(listing(cubin))[1:])]


def milliseconds(
    direct: list[int], linear: list[int], width: int, height: int, scene: str, radius: float, way: str
) -> tuple[float, float]:
    """Time of both forms for a picture. direct: instructions a tap and a row; linear: a tap, a fine window, a coarse
    one, a row."""
    columns = np.arange(width)
    signed = (2 * columns / (width - 1) - 1) * radius if scene == "ramp" else np.full(width, float(radius))
    radii = np.abs(signed)
    reach = [max(radii[left : left + TILE_X].max() + BAND, FOCUS) for left in range(0, width, TILE_X)]
    total = np.zeros(2)
    for tile, left in enumerate(range(0, width, TILE_X)):
        if way == "forward":
            others = enumerate(reach)
            far = max(one for other, one in others if one >= max(abs(other - tile) - 1, 0) * TILE_X)
        else:
            far = reach[tile]
        by_row = [
            costs(direct, linear, left, math.ceil(far), dy, radii, scene, way) for dy in range(math.ceil(far) + 1)
        ]
        for top in range(0, height, TILE_Y):
            for dy in range(max(-math.ceil(far), 1 - TILE_Y - top), min(math.ceil(far), height - 1 - top) + 1):
                total += by_row[abs(dy)]
    direct_ms, linear_ms = (1e3 * WARPS * total / ISSUED).tolist()
    return direct_ms, linear_ms


def costs(
    direct: list[int], linear: list[int], left: int, far: int, dy: int, radii: np.ndarray, scene: str, way: str
) -> np.ndarray:
    """Instructions of a warp for a tile's row at `dy`, in both forms."""
    width = radii.size
    columns = min(int(math.sqrt(far * far - dy * dy)) + 1, width - 1)
    first, last = max(-columns, 1 - TILE_X - left), min(columns, width - 1 - left)
    windows = 0
    taps = 0
    coarse = range(max(-columns, -left - (TILE_X + COARSE - 2)) // COARSE * COARSE, last + 1, COARSE)
    for begin in coarse:
        if crossed(begin, COARSE, left, dy, radii, scene, way):
            windows += COARSE // FINE
            taps += sum(
                FINE * crossed(fine, FINE, left, dy, radii, scene, way) for fine in range(begin, begin + COARSE, FINE)
            )
    return np.array(
        [
            direct[0] * (last - first + 1) + direct[1],
            linear[0] * taps + linear[1] * windows + linear[2] * len(coarse) + linear[3],
        ]
    )


def crossed(first: int, wide: int, left: int, dy: int, radii: np.ndarray, scene: str, way: str) -> bool:
    """Whether a rim may cross the window: whether it is neither out of reach nor at full weight throughout."""
    begin, end = (left + first, left + first + TILE_X + wide - 1) if way == "forward" else (left, left + TILE_X)
    there = radii[max(begin, 0) : max(end, 0)]
    if there.size == 0:
        return False
    nearest = math.hypot(max(first, -(first + wide - 1), 0), dy)
    farthest = math.hypot(max(abs(first), abs(first + wide - 1)), dy)
    near = -math.inf if scene == "noise" else there.min() - BAND
    return max(there.max() + BAND, FOCUS) >= nearest and farthest > near


if __name__ == "__main__":
    main(tyro.cli(Settings))
