"""make-dataset of large photographs: time by stage, and memory, with one view at a time and with several.

    python -m benchmarks.speed.make_dataset --out DIR

Each dataset is made by a process of its own, with all numbers of threads in turn, and must have the same bytes. The
photographs are textures with grain; their depth is given. Wall time is meaningful only on an idle machine of cores of
its own. `serial_s` is the processor time of the main thread, in which nothing is done side by side: by Amdahl's law
n cores gain at most a factor of 1 / (s + (1 - s) / n), where s is its share.
"""

from __future__ import annotations

import hashlib
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch and numba are imported

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import tyro  # noqa: E402

from benchmarks.speed.scatter import disparity  # noqa: E402
from dofbench.core.cameras import Camera  # noqa: E402
from dofbench.core.files import write_csv  # noqa: E402
from dofbench.core.images import write_exr  # noqa: E402
from dofbench.core.progress import Advance, Progress  # noqa: E402
from dofbench.scenes import export  # noqa: E402

MEGA = 1e6
Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder of make-dataset.csv."""
    views: int = 8
    """Number of photographs."""
    width: int = 4000
    """Width of the photographs, pixels."""
    height: int = 3000
    """Height of the photographs, pixels."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of threads to compare, each as OMP_NUM_THREADS."""
    repeats: int = 3
    """Datasets made with each number."""


def write_scene(folder: Path, views: int, width: int, height: int) -> None:
    """Write photographs as JPEG and their depth, in nerfstudio's layout."""
    rng = np.random.default_rng(0)
    near = disparity("edges", height // 4, width // 4)
    depth = 1 / (0.1 + 0.9 * cv2.resize(near, (width, height), interpolation=cv2.INTER_NEAREST))
    texture = sum(
        cv2.resize(rng.random((height // cell, width // cell, 3), np.float32), (width, height)) for cell in (64, 16, 4)
    )
    names, depths, cameras = [], [], []
    for index in range(views):
        names.append(f"images/{index:03}.jpg")
        depths.append(f"depth/{index:03}.exr")
        pose = np.eye(4)
        pose[0, 3] = -0.01 * index
        cameras.append(Camera(width, height, width, width, width / 2, height / 2, pose))
        grain = rng.normal(0, 4, (height, width, 1)).astype(np.float32)
        picture = np.clip(np.roll(texture, 5 * index, axis=1) * 85 + grain, 0, 255).astype(np.uint8)
        (folder / names[-1]).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / names[-1]), picture)
        write_exr(folder / depths[-1], depth)
    export.write_transforms(folder / "transforms.json", names, cameras, depth_paths=depths)


class Stages(Progress):
    """Times of the stages, and of what comes between them."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self._at = self._now()

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """Time a stage."""
        self.lap(f"before {name}")
        yield lambda done: None
        self.lap(name)

    def lap(self, name: str) -> None:
        """Add a row with what has passed since the last one."""
        now = self._now()
        wall, processor, serial = (round(after - before, 3) for after, before in zip(now, self._at, strict=True))
        self.rows.append({"stage": name, "wall_s": wall, "processor_s": processor, "serial_s": serial})
        self._at = now

    def _now(self) -> tuple[float, float, float]:
        return time.perf_counter(), time.process_time(), time.thread_time()


def make(scene: Path, out: Path) -> tuple[list[Row], str]:
    """Make the dataset in this process; returns a row for each stage, and a checksum of all files."""
    from dofbench.datasets.synthesis.builder import make
    from dofbench.datasets.synthesis.dataset_options import MakeDataset

    stages = Stages()
    begun = stages._now()
    make(MakeDataset(scene=str(scene), out=out), stages)
    stages.lap("after blur")
    stages._at = begun
    stages.lap("all")
    peak = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    files = sorted(path for path in out.rglob("*") if path.is_file())
    digest = hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in files))
    return [row | {"peak_mib": peak} for row in stages.rows], digest.hexdigest()


def in_own_process(scene: Path, out: Path, threads: int) -> tuple[list[Row], str]:
    """`make` in a new process with so many threads."""
    os.environ["OMP_NUM_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = str(threads)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(make, scene, out).result()


def main(settings: Settings) -> None:
    rows, digests = [], set()
    with tempfile.TemporaryDirectory() as place:
        scene = Path(place) / "scene"
        write_scene(scene, settings.views, settings.width, settings.height)
        # The first dataset compiles the kernels, and isn't counted.
        for repeat in range(-1, settings.repeats):
            for threads in settings.threads if repeat >= 0 else settings.threads[:1]:
                load = os.getloadavg()[0]
                with tempfile.TemporaryDirectory(dir=place) as out:
                    found, digest = in_own_process(scene, Path(out), threads)
                digests.add(digest)
                same = {"threads": threads, "views": settings.views, "repeat": repeat, "load": round(load, 1)}
                size = {"megapixels": settings.width * settings.height / MEGA}
                if repeat >= 0:
                    rows += [same | size | row for row in found]
                    print(rows[-1], flush=True)
                    write_csv(settings.out / "make-dataset.csv", list(rows[0]), rows)
    if len(digests) > 1:
        raise SystemExit("datasets differ in their bytes")


if __name__ == "__main__":
    main(tyro.cli(Settings))
