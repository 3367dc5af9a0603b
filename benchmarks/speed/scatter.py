"""The linear scatter at the size of a photograph: time, memory, energy, and cost against radius and pixels.

    python -m benchmarks.speed.scatter --out reports/speed [--width 4032] [--height 3024] [--radius 120] [--repeats 3]
    python -m benchmarks.speed.scatter --out reports/speed --only energy

Parts, in processes of their own: `photograph` (an 8-bit image and its depth through the dataset builder's own
function: decode, scatter, encode; peak memory of the process), `layered` (the same by the layered renderer; slow),
`energy` (HDR highlights of 1e6 against float64 sums at every pixel of their discs), `cost` (both forms against radius
and against pixels). Writes a CSV for each into --out and draws cost.png there. Wall time is meaningful only if nothing
else runs on the machine; processor time is less affected.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch and numba are imported

import numpy as np  # noqa: E402

PARTS = ("photograph", "layered", "energy", "cost")
KINDS = ("waves", "edges", "plane")
HIGHLIGHT = 1e6
DISPARITIES = 0.1, 1.0  # disparity range of the photographed scene, 1 / scene unit
MILLION = 1e6


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


# ------------------------------------------------------------------------------------------------ the photograph


def photograph(kind: str, renderer: str, width: int, height: int, radius: float) -> dict:
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
    shared = Photography(DisparityRange(low, high), per_view=False, blur=Blur(renderer=renderer))
    corner = depth[:40, :40].copy()
    # The corner has the same largest radius as the whole image, so that the same form is loaded or compiled
    corner[0, 0] = 1 / high
    shallow_image(sharp[:40, :40].copy(), corner, record, shared)
    prepared, watch = peak_memory(), Stopwatch()
    encoded, linear = shallow_image(sharp, depth, record, shared)
    wall, processor = watch.read()
    assert np.isfinite(encoded).all() and np.isfinite(linear).all()
    return {
        "renderer": renderer,
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


# ------------------------------------------------------------------------------------------------ energy


def exact(image: np.ndarray, radius: np.ndarray, rows: np.ndarray, columns: np.ndarray, alpha: float) -> np.ndarray:
    """(N, 3) float64: the definition's sums at target pixels, over every source that can reach them."""
    from numba import njit, prange

    from dofbench.core.lens import AREA_EPSILON

    @njit(parallel=True)
    def sums(image, radius, rows, columns, reach):
        height, width = radius.shape
        results = np.zeros((rows.size, 3))
        for i in prange(rows.size):
            red = green = blue = total = 0.0
            for y in range(max(0, rows[i] - reach), min(height, rows[i] + reach + 1)):
                for x in range(max(0, columns[i] - reach), min(width, columns[i] + reach + 1)):
                    size = float(radius[y, x])
                    rest = float((y - rows[i]) ** 2 + (x - columns[i]) ** 2)
                    if rest > (size + 6.0) ** 2:  # below exp(-48) a weight is negligible even in float64
                        continue
                    weight = 1.0 / (size * size + AREA_EPSILON)
                    if size < 6.0 or rest > (size - 6.0) ** 2:
                        weight /= 1.0 + np.exp(2.0 * alpha * (np.sqrt(rest) - size))
                    red += weight * image[y, x, 0]
                    green += weight * image[y, x, 1]
                    blue += weight * image[y, x, 2]
                    total += weight
            results[i] = red / total, green / total, blue / total
        return results

    return sums(image, radius, rows, columns, int(radius.max()) + 7)


def energy(kind: str, width: int, height: int, radius: float) -> dict:
    """Light of three highlights of 1e6, spread over their discs in float32, against float64 sums at their pixels."""
    import torch

    from dofbench.core.lens import ALPHA
    from dofbench.runtime.ops import load

    rng = np.random.default_rng(2)
    image = rng.random((height, width, 3), dtype=np.float32)
    radii = np.float32(radius) * disparity(kind, height, width)
    near = np.zeros(radii.shape, dtype=bool)
    rows, columns = np.ogrid[:height, :width]
    for share in (0.0, 0.5, 1.0):  # highlights at one corner, inside, and at the opposite corner
        y, x = int(share * (height - 1)), int(share * (width - 1))
        image[y, x], radii[y, x] = HIGHLIGHT, radius
        near |= (rows - y) ** 2 + (columns - x) ** 2 < (radius + 3) ** 2
    watch = Stopwatch()
    with torch.no_grad():
        blurred = load("scatter", "cpu")(torch.from_numpy(image), torch.from_numpy(radii), form="linear").numpy()
    wall, processor = watch.read()
    lit = np.argwhere(near)
    dark = np.stack([rng.integers(0, height, 2000), rng.integers(0, width, 2000)], axis=1)
    dark = dark[~near[dark[:, 0], dark[:, 1]]]
    found = {"highlights": lit, "elsewhere": dark}
    sums = {
        name: (
            blurred[at[:, 0], at[:, 1]].astype(np.float64),
            exact(image, radii, np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]), ALPHA),
        )
        for name, at in found.items()
    }
    bright, expected = sums["highlights"]
    error = {name: float((np.abs(a - b) / b).max()) for name, (a, b) in sums.items()}
    return {
        "disparity": kind,
        "width": width,
        "height": height,
        "largest_radius": radius,
        "pixels_compared": len(lit) + len(dark),
        "light_float64": f"{expected.sum():.9e}",
        "light_error": f"{abs(bright.sum() / expected.sum() - 1):.1e}",
        "largest_pixel_error_in_discs": f"{error['highlights']:.1e}",
        "largest_pixel_error_elsewhere": f"{error['elsewhere']:.1e}",
        "wall_s": round(wall, 2),
        "processor_s": round(processor, 2),
    }


# ------------------------------------------------------------------------------------------------ cost


def cost(kind: str, form: str, cases: list[tuple[int, int, float]], repeats: int) -> list[dict]:
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


def measure_cost(width: int, height: int, radius: float, repeats: int) -> list[dict]:
    """Cost against radius at an eighth of the width, and against pixels at two radii, without cases that take the
    direct form minutes."""
    radii = (4.0, 8.0, 12.0, 16.0, 18.0, 24.0, 32.0, 48.0, 64.0, 96.0, 120.0, 180.0, 240.0)
    rows = []
    for kind in ("waves", "edges"):
        for form in ("direct", "linear"):
            cases = [(width // 8, height // 8, r) for r in radii if form == "linear" or r <= radius]
            found = in_new_process("cost", kind=kind, form=form, cases=cases, repeats=repeats)
            rows += [{"by": "radius", **row} for row in found]
    lines = ("direct", 32.0, 2), ("linear", 32.0, 1), ("direct", radius, 8), ("linear", radius, 1)
    for form, largest, finest in lines:
        cases = [(width // d, height // d, largest) for d in (32, 16, 8, 4, 2, 1) if d >= finest]
        found = in_new_process("cost", kind="edges", form=form, cases=cases, repeats=repeats)
        rows += [{"by": "pixels", **row} for row in found]
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """cost.png: processor time against radius, and against pixels."""
    from dofbench.evaluation.figures import look, new_figure, save

    figure = new_figure(11.0, 4.2)
    by_radius, by_pixels = figure.subplots(1, 2)
    panels = (
        (by_radius, "radius", "largest_radius", ("form", "disparity")),
        (by_pixels, "pixels", "megapixels", ("form", "largest_radius")),
    )
    for axes, by, across, names in panels:
        chosen = [row for row in rows if row["by"] == by]
        for index, key in enumerate(dict.fromkeys(tuple(row[name] for name in names) for row in chosen)):
            line = [row for row in chosen if tuple(row[name] for name in names) == key]
            unit = "" if by == "radius" else " px"
            axes.plot(
                [float(row[across]) for row in line],
                [float(row["processor_s"]) for row in line],
                marker="o",
                markersize=3,
                label=f"{key[0]}, {key[1]}{unit}",
                **look(index),
            )
        axes.set(xscale="log", yscale="log", ylabel="processor time, s")
        axes.legend()
    size = next(row for row in rows if row["by"] == "radius")
    by_radius.set(xlabel="largest CoC radius, px", title=f"{size['width']} x {size['height']}")
    by_pixels.set(xlabel="megapixels", title="surfaces with edges and noise")
    save(figure, path)


# ------------------------------------------------------------------------------------------------ running


def in_new_process(part: str, **case):
    """Call the function of this name in a new process, so that memory and caches of earlier cases don't count."""
    command = [sys.executable, __file__, "--child", part, json.dumps(case)]
    result = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
    found = json.loads(result.stdout.splitlines()[-1])
    load = round(os.getloadavg()[0], 1)
    rows = found if isinstance(found, list) else [found]
    for row in rows:
        row["load"] = load
        print(row, flush=True)
    return found


def write(path: Path, rows: list[dict]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--width", type=int, default=4032)
    parser.add_argument("--height", type=int, default=3024)
    parser.add_argument("--radius", type=float, default=120.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=PARTS)
    arguments = parser.parse_args()
    size = {"width": arguments.width, "height": arguments.height, "radius": arguments.radius}
    arguments.out.mkdir(parents=True, exist_ok=True)
    chosen = (arguments.only,) if arguments.only else PARTS
    if "photograph" in chosen:
        rows = [
            in_new_process("photograph", kind=kind, renderer="scatter", **size)
            for kind in KINDS
            for _ in range(arguments.repeats)
        ]
        write(arguments.out / "photograph.csv", rows)
    if "layered" in chosen:
        write(arguments.out / "layered.csv", [in_new_process("photograph", kind="edges", renderer="layered", **size)])
    if "energy" in chosen:
        write(arguments.out / "energy.csv", [in_new_process("energy", kind=kind, **size) for kind in KINDS])
    if "cost" in chosen:
        rows = measure_cost(repeats=arguments.repeats, **size)
        write(arguments.out / "cost.csv", rows)
        draw(rows, arguments.out / "cost.png")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        children = {"photograph": photograph, "energy": energy, "cost": cost}
        print(json.dumps(children[sys.argv[2]](**json.loads(sys.argv[3]))))
    else:
        main()
