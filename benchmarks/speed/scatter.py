"""The scatter renderer at the size of a photograph: time, memory, and growth with radius and pixels.

    python -m benchmarks.speed.scatter --out reports/speed
    python -m benchmarks.speed.scatter --out reports/speed --only photograph

Each case has its own process. `photograph`: an 8-bit image and its depth through the dataset builder's own function
(decode, scatter, encode), with the peak memory of the process. `cost`: both forms against radius and against pixels.
Wall time is meaningful only on an idle machine; processor time is less affected.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch and numba are imported

import numpy as np  # noqa: E402
import tyro  # noqa: E402

from dofbench.core.files import write_csv  # noqa: E402

KINDS = ("waves", "edges", "plane")
DISPARITIES = 0.1, 1.0  # disparity range of the photographed scene, 1 / scene unit
MILLION = 1e6
Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder of photograph.csv and cost.csv."""
    width: int = 4032
    """Width of the image, pixels."""
    height: int = 3024
    """Height of the image, pixels."""
    radius: float = 120.0
    """Largest CoC radius, pixels."""
    repeats: int = 3
    """Runs of each case."""
    only: Literal["photograph", "cost", ""] = ""
    """Part to measure; both where none is named."""


def disparity(kind: str, height: int, width: int) -> np.ndarray:
    """(H, W) float32 in [0, 1]: smooth waves; overlapping surfaces with sharp edges, and noise on them; all 1."""
    rng = np.random.default_rng(0)
    rows, columns = (np.arange(size, dtype=np.float32) / width for size in (height, width))
    if kind == "plane":
        return np.ones((height, width), np.float32)
    if kind == "waves":
        waves = np.zeros((height, width), np.float32)
        for _ in range(6):
            down, right, phase = rng.uniform(-3, 3), rng.uniform(-3, 3), rng.random()
            waves += np.cos(
                np.float32(2 * np.pi)
                * (np.float32(down) * rows[:, None] + np.float32(right) * columns + np.float32(phase))
            )
        return (waves - waves.min()) / np.ptp(waves)
    surfaces = np.zeros((height, width), np.float32)
    for level in np.linspace(0.05, 1.0, 24, dtype=np.float32):
        y, x = rng.uniform(0, height / width), rng.random()
        surfaces[np.hypot(rows[:, None] - y, columns - x) < rng.uniform(0.02, 0.25)] = level
    return np.clip(surfaces + np.float32(0.03) * rng.standard_normal((height, width), dtype=np.float32), 0.0, 1.0)


def picture(height: int, width: int) -> np.ndarray:
    """(H, W, 3) uint8: noise, for which both forms take as long as for a photograph."""
    return np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)


class Stopwatch:
    """Wall and processor time, seconds, of this process."""

    def __init__(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        return time.perf_counter() - self._wall, time.process_time() - self._processor


def peak_memory() -> float:
    """Largest resident size of this process so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def photograph(kind: str, width: int, height: int, radius: float) -> list[Row]:
    """Make one photograph in this process, which should do nothing else, since its peak memory is measured."""
    from dofbench.core.blur import Blur
    from dofbench.core.lens import DisparityRange, Lens
    from dofbench.datasets.format.schema import ViewRecord
    from dofbench.datasets.synthesis.render_views import Photography, shallow_image

    low, high = DISPARITIES
    sharp = picture(height, width)
    depth = 1 / (np.float32(low) + np.float32(high - low) * disparity(kind, height, width))
    record = ViewRecord(
        name="0",
        split="train",
        k_px=radius,
        max_coc_px=radius,
        focus_scene=1 / low,
        aperture_scene=radius / (high - low),
        focus=0.0,
        aperture=radius / Lens(1.0, 0.0).radius_per_disparity(width),
    )
    shared = Photography(DisparityRange(low, high), per_view=False, blur=Blur(renderer="scatter"))
    corner = depth[:40, :40].copy()
    # The corner has the same largest radius as the whole image, so that the same form is loaded or compiled
    corner[0, 0] = 1 / high
    shallow_image(sharp[:40, :40].copy(), corner, record, shared)
    prepared, watch = peak_memory(), Stopwatch()
    encoded, linear = shallow_image(sharp, depth, record, shared)
    wall, processor = watch.read()
    assert np.isfinite(encoded).all() and np.isfinite(linear).all()
    row = {
        "disparity": kind,
        "width": width,
        "height": height,
        "largest_radius": radius,
        "mean_radius": round(float(radius * (1 / depth - low).mean() / (high - low)), 1),
        "wall_s": round(wall, 2),
        "processor_s": round(processor, 2),
        "peak_mib": round(peak_memory()),
        "peak_before_mib": round(prepared),
    }
    return [row]


def cost(kind: str, form: str, cases: list[tuple[int, int, float]], repeats: int) -> list[Row]:
    """Least wall and processor time of `repeats` runs of the scatter alone, by (width, height, largest radius)."""
    import torch

    from dofbench.runtime.ops import load

    scatter = load("scatter", "cpu")
    rows = []
    for width, height, radius in cases:
        image = torch.from_numpy(np.random.default_rng(3).random((height, width, 3), dtype=np.float32))
        radii = torch.from_numpy(np.float32(radius) * disparity(kind, height, width))
        times = []
        with torch.no_grad():
            small = radii[:40, :40].contiguous()
            small[0, 0] = radius
            scatter(image[:40, :40].contiguous(), small, form=form)  # loads or compiles
            for _ in range(repeats):
                watch = Stopwatch()
                scatter(image, radii, form=form)
                times.append(watch.read())
        wall, processor = (min(column) for column in zip(*times, strict=True))
        rows.append(
            {
                "disparity": kind,
                "form": form,
                "width": width,
                "height": height,
                "megapixels": round(width * height / MILLION, 4),
                "largest_radius": radius,
                "mean_radius": round(float(radii.mean()), 1),
                "wall_s": round(wall, 4),
                "processor_s": round(processor, 4),
            }
        )
    return rows


def measure_cost(width: int, height: int, radius: float, repeats: int) -> list[Row]:
    """Cost against radius at an eighth of the width, and against pixels at two radii, without cases that take the
    direct form minutes."""
    radii = (4.0, 8.0, 12.0, 16.0, 18.0, 24.0, 32.0, 48.0, 64.0, 96.0, 120.0, 180.0, 240.0)
    rows = []
    for kind in ("waves", "edges"):
        for form in ("direct", "linear"):
            cases = [(width // 8, height // 8, r) for r in radii if form == "linear" or r <= radius]
            rows += [{"by": "radius", **row} for row in in_new_process(cost, kind, form, cases, repeats)]
    lines = ("direct", 32.0, 2), ("linear", 32.0, 1), ("direct", radius, 8), ("linear", radius, 1)
    for form, largest, finest in lines:
        cases = [(width // d, height // d, largest) for d in (32, 16, 8, 4, 2, 1) if d >= finest]
        rows += [{"by": "pixels", **row} for row in in_new_process(cost, "edges", form, cases, repeats)]
    return rows


def in_new_process(part: Callable[..., list[Row]], *case: Any) -> list[Row]:
    """Call a part in a new process, so that memory and caches of earlier cases don't count."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        rows = pool.submit(part, *case).result()
    load = round(os.getloadavg()[0], 1)
    for row in rows:
        row["load"] = load
        print(row, flush=True)
    return rows


def main(settings: Settings) -> None:
    """Measure and write the CSVs."""
    size = settings.width, settings.height, settings.radius
    measured: dict[str, list[Row]] = {}
    if settings.only != "cost":
        cases = [kind for kind in KINDS for _ in range(settings.repeats)]
        measured["photograph"] = [row for kind in cases for row in in_new_process(photograph, kind, *size)]
    if settings.only != "photograph":
        measured["cost"] = measure_cost(*size, settings.repeats)
    for name, rows in measured.items():
        write_csv(settings.out / f"{name}.csv", tuple(rows[0]), rows)


if __name__ == "__main__":
    main(tyro.cli(Settings))
