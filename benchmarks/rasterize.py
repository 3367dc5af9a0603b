"""The rasteriser's time by stage, and its blending compared with a plain C++ program on the same Gaussians.

    python benchmarks/rasterize.py

Needs g++ for the comparison (rasterize_peer.cpp). Every figure is the median of interleaved runs, in milliseconds;
on a busy machine only their ratios are meaningful.
"""

from __future__ import annotations

import ctypes
import functools
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

from dofbench.compute.threads import configure_threads

configure_threads()

# The libraries read their thread settings when imported.
import numba  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402
from dofbench.kernels.rasterize import cpu  # noqa: E402
from dofbench.kernels.rasterize import cpu_layout as layout  # noqa: E402
from random_scene import scene  # noqa: E402

from dofbench.core.cameras import Camera  # noqa: E402
from dofbench.gaussians.forward.lens_pattern import lens_points  # noqa: E402

RUNS = 15
# Gaussians, width, height, standard deviation in pixels: about 42, 80 and 178 thousand intersections with tiles.
PEER_SIZES = ((10_000, 256, 192, 2.9), (30_000, 256, 192, 1.7), (50_000, 504, 384, 2.3))
STAGE_SIZES = ((10_000, 504, 378, 4.0), (50_000, 504, 378, 2.3), (100_000, 504, 378, 1.8))
# Largest variance of blur, px**2: no argument, all zero, discs of up to 4 and up to 16 pixels in diameter.
BLURS = (None, 0.0, 1.0, 16.0)
RADIUS = 6.0  # px, largest circle of confusion of the views from points of the lens
STAGES = ("project", "depth_order", "fill_tiles", "blend", "blend_backward", "project_backward")


class Clock:
    """Wraps the stages that `cpu` calls, and records how long each takes."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {name: [] for name in (*STAGES, "forward", "backward")}
        self.results: dict[str, object] = {}
        self.arguments: dict[str, tuple] = {}
        for name in STAGES:
            setattr(cpu, name, self._timed(name, getattr(cpu, name)))

    def _timed(self, name, stage):
        def call(*arguments):
            start = perf_counter()
            result = stage(*arguments)
            self.times[name].append(perf_counter() - start)
            self.results[name], self.arguments[name] = result, arguments
            return result

        return call

    def step(self, parameters, camera, blur: torch.Tensor | None = None) -> None:
        """One forward and backward pass with gradients of colour and depth."""
        inputs = [parameter.clone().requires_grad_() for parameter in parameters]
        blur = None if blur is None else blur.clone().requires_grad_()
        start = perf_counter()
        raster = cpu.rasterize(*inputs, camera=camera, blur=blur)
        self.times["forward"].append(perf_counter() - start)
        gradients = [torch.ones_like(raster.color), torch.ones_like(raster.depth)]
        start = perf_counter()
        torch.autograd.backward([raster.color, raster.depth], gradients)
        self.times["backward"].append(perf_counter() - start)

    def take(self) -> dict[str, float]:
        """Median milliseconds by stage; clears the records."""
        medians = {name: 1e3 * float(np.median(times)) for name, times in self.times.items()}
        for times in self.times.values():
            times.clear()
        return medians


@numba.njit
def tile_lists(order, gaussians, width, height):
    """The C++ program's lists: 16 x 16 tiles that each ellipse's bounding box meets, nearest Gaussian first."""
    columns, rows = (width + 15) // 16, (height + 15) // 16
    counts = np.zeros(columns * rows + 1, np.int32)
    starts, ids = np.zeros(columns * rows + 1, np.int32), np.empty(0, np.int32)
    for fill in (False, True):
        if fill:
            starts[1:] = np.cumsum(counts)[:-1]
            ids = np.empty(starts[-1], np.int32)
            counts[:-1] = starts[:-1]
        for i in order:
            x, y, a, b, c, opacity = gaussians[i, :6]
            reach = 2 * math.log(255 * opacity) / (a * c - b * b)
            half_x, half_y = math.sqrt(reach * c), math.sqrt(reach * a)
            left, right = max(math.ceil(x - half_x - 0.5), 0), min(math.floor(x + half_x - 0.5), width - 1)
            top, bottom = max(math.ceil(y - half_y - 0.5), 0), min(math.floor(y + half_y - 0.5), height - 1)
            if left > right or top > bottom:
                continue
            for row in range(top // 16, bottom // 16 + 1):
                for column in range(left // 16, right // 16 + 1):
                    tile = row * columns + column
                    if fill:
                        ids[counts[tile]] = i
                    counts[tile] += 1
    return starts, ids


class Peer:
    """The C++ program, which gets the records made by our projection."""

    def __init__(self, library, records, order, camera: Camera) -> None:
        self.library, self.camera = library, camera
        r = records.reshape(-1, layout.RECORD)
        l11, l21, l22 = (r[:, k] / layout.EXPONENT_SCALE for k in (layout.L11, layout.L21, layout.L22))
        opacity = np.zeros(len(r), np.float32)
        opacity[order] = np.exp2(r[order, layout.LOG2_OPACITY])
        columns = [
            r[:, layout.MX],
            r[:, layout.MY],
            l11 * l11,
            l11 * l21,
            l21 * l21 + l22 * l22,
            opacity,
            r[:, layout.RED],
            r[:, layout.GREEN],
            r[:, layout.BLUE],
            r[:, layout.T0],
        ]
        self.gaussians = np.ascontiguousarray(np.stack(columns, 1), np.float32)
        self.starts, self.ids = tile_lists(order, self.gaussians, camera.width, camera.height)
        shape = (camera.height, camera.width)
        self.color, self.depth, self.alpha = np.empty((*shape, 3), np.float32), *np.empty((2, *shape), np.float32)
        self.looked_at, self.out = np.empty(len(self.starts), np.int32), np.empty((len(self.ids), 10), np.float32)
        self.ones = np.ones((*shape, 3), np.float32), np.ones(shape, np.float32)

    def _call(self, function, *arrays) -> float:
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
        start = perf_counter()
        function(*pointers[:3], self.camera.width, self.camera.height, *pointers[3:])
        return perf_counter() - start

    def forward(self) -> float:
        """Seconds of one forward pass."""
        return self._call(
            self.library.forward,
            self.gaussians,
            self.starts,
            self.ids,
            self.color,
            self.depth,
            self.alpha,
            self.looked_at,
        )

    def backward(self) -> float:
        """Seconds of one backward pass."""
        return self._call(
            self.library.backward,
            self.gaussians,
            self.starts,
            self.ids,
            self.looked_at,
            self.color,
            self.depth,
            *self.ones,
            self.out,
        )


def build_peer(folder: Path) -> ctypes.CDLL:
    """Compile rasterize_peer.cpp."""
    source = Path(__file__).with_name("rasterize_peer.cpp")
    library = folder / "peer.so"
    options = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run(["g++", *options, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def compare(clock: Clock, library: ctypes.CDLL) -> None:
    """Print blending times and those of the C++ program."""
    print("| scene | intersections (C++ 16 x 16) | forward | C++ | ratio | backward | C++ | ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for n, width, height, pixels in PEER_SIZES:
        parameters, camera = scene(n, width, height, pixels)
        clock.step(parameters, camera)
        records = clock.arguments["fill_tiles"][0]
        peer = Peer(library, records, clock.results["depth_order"], camera)
        clock.take()
        forward, backward = [], []
        for _ in range(RUNS):
            clock.step(parameters, camera)
            forward.append(1e3 * peer.forward())
            backward.append(1e3 * peer.backward())
        ours = clock.take()
        ids = clock.results["fill_tiles"][1]
        theirs = float(np.median(forward)), float(np.median(backward))
        print(
            f"| {n} at {width} x {height} | {len(ids)} ({len(peer.ids)}) | {ours['blend']:.2f} | {theirs[0]:.2f} | "
            f"{ours['blend'] / theirs[0]:.2f} | {ours['blend_backward']:.2f} | {theirs[1]:.2f} | "
            f"{ours['blend_backward'] / theirs[1]:.2f} |"
        )


def by_stage(clock: Clock) -> None:
    """Print the time of every stage, and of a whole forward and backward pass through autograd."""
    names = (*STAGES, "forward", "backward")
    print(f"| scene | {' | '.join(names)} |")
    print("| --- " * (len(names) + 1) + "|")
    for n, width, height, pixels in STAGE_SIZES:
        parameters, camera = scene(n, width, height, pixels)
        clock.step(parameters, camera)
        clock.take()
        for _ in range(RUNS):
            clock.step(parameters, camera)
        medians = clock.take()
        print(f"| {n} at {width} x {height} | {' | '.join(f'{medians[name]:.2f}' for name in names)} |")


def by_blur(clock: Clock) -> None:
    """Print the times with a blur for each Gaussian, with variances spread evenly from 0 to a largest one."""
    names = (*STAGES, "forward", "backward")
    print(f"| largest blur, px**2 | intersections | {' | '.join(names)} |")
    print("| --- " * (len(names) + 2) + "|")
    n, width, height, pixels = STAGE_SIZES[1]
    parameters, camera = scene(n, width, height, pixels)
    times: dict[float | None, list[dict[str, float]]] = {largest: [] for largest in BLURS}
    intersections = {}
    for _ in range(RUNS):
        for largest in BLURS:
            clock.step(parameters, camera, None if largest is None else torch.linspace(0, largest, n))
            times[largest].append(clock.take())
            intersections[largest] = len(clock.results["fill_tiles"][1])
    for largest, runs in times.items():
        medians = {name: float(np.median([run[name] for run in runs])) for name in names}
        print(f"| {largest} | {intersections[largest]} | {' | '.join(f'{medians[name]:.2f}' for name in names)} |")


def by_points() -> None:
    """Print the times of a view from one point of the lens, as `rasterize` makes it, and of the views from five."""
    print("| scene | one point, forward | backward | five points, forward | backward | five views / one |")
    print("| --- " * 6 + "|")
    points = lens_points(1)
    for n, width, height, pixels in STAGE_SIZES:
        parameters, camera = scene(n, width, height, pixels)
        radius = torch.linspace(-RADIUS, RADIUS, n)
        one = functools.partial(cpu.rasterize, camera=camera)
        five = functools.partial(cpu.rasterize_from_points, camera=camera, points=points, radius=radius)
        times: dict[str, list[tuple[float, float]]] = {"one": [], "five": []}
        for run in range(RUNS + 1):
            pairs = forward_and_backward(one, parameters), forward_and_backward(five, parameters)
            if run:  # the first compiles
                for name, pair in zip(times, pairs, strict=True):
                    times[name].append(pair)
        cells = [float(np.median([pair[k] for pair in times[name]])) for name in times for k in range(2)]
        ratio = (cells[2] + cells[3]) / (cells[0] + cells[1])
        print(f"| {n} at {width} x {height} | {' | '.join(f'{cell:.2f}' for cell in cells)} | {ratio:.2f} |")


def forward_and_backward(rasterise: Callable[..., Any], parameters: list[torch.Tensor]) -> tuple[float, float]:
    """Milliseconds of both passes, with gradients of colour alone."""
    inputs = [parameter.clone().requires_grad_() for parameter in parameters]
    start = perf_counter()
    images = rasterise(*inputs)
    images = images if isinstance(images, torch.Tensor) else images.color
    middle = perf_counter()
    torch.autograd.backward([images], [torch.ones_like(images)])
    return 1e3 * (middle - start), 1e3 * (perf_counter() - middle)


def first_call() -> None:
    """Print how long the first forward and backward pass takes in a new process, without and with a cache."""
    program = (
        "import sys, time; sys.path.insert(0, sys.argv[1]); import rasterize as bench; clock = bench.Clock();"
        "start = time.perf_counter(); clock.step(*bench.scene(100, 64, 48, 2.0)); print(time.perf_counter() - start)"
    )
    with tempfile.TemporaryDirectory() as folder:
        for what in ("cold", "cached"):
            command = [sys.executable, "-c", program, str(Path(__file__).parent)]
            environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            print(f"first call, {what}: {float(done.stdout):.1f} s")


def main() -> None:
    """Print all tables."""
    clock = Clock()
    print(f"{numba.get_num_threads()} threads; milliseconds, medians of {RUNS}\n")
    by_stage(clock)
    print()
    by_blur(clock)
    print()
    by_points()
    print()
    if shutil.which("g++"):
        with tempfile.TemporaryDirectory() as folder:
            compare(clock, build_peer(Path(folder)))
    else:
        print("g++ was not found on PATH: no comparison")
    print()
    first_call()


if __name__ == "__main__":
    main()
