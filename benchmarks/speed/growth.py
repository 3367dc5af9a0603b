"""How the cost of what is done once a scene grows with its views: processor time and memory, and the exponents.

    python -m benchmarks.speed.growth --out reports/speed

Made-up scenes of small photographs: `row`, cameras side by side, each before points of its own; `round`, cameras around
one thing; both have as many points as structure from motion finds, a number a view, of which each view sees some.
`cloud`: like round, but a cloud without tracks, of the same size whatever the views. Each case has its own process.
Exponents are on the page: the slope of log cost over log views, by least squares.
"""

from __future__ import annotations

import argparse
import csv
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch and numba are imported

import numpy as np  # noqa: E402

from dofbench.core.cameras import Camera  # noqa: E402
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView  # noqa: E402
from dofbench.core.files import write_csv  # noqa: E402

VIEWS = (10, 20, 40, 80, 160, 320)
POINTS = 300  # a view
SEEN = 1000  # of them that a view sees at most: features a photograph
CLOUD = 20_000  # points of a cloud without tracks
WIDTH, HEIGHT = 96, 72
REPEATS, ENOUGH = 3, 2.0  # at most so often, and not again after so many seconds
Row = dict[str, Any]
Case = tuple[str, str, int]


def scene(count: int, kind: str) -> TrainingSet:
    """`count` views of random images. kind: how they lie (the module says)."""
    random = np.random.default_rng(count)
    if kind == "row":
        along, angle = 0.3 * np.arange(count), np.zeros(count)
        centres = np.stack([along, 0 * along, 0 * along], axis=1)
        xyz = random.uniform((-2, -2, 4), (along[-1] + 2, 2, 8), (POINTS * count, 3))
    else:
        angle = 2 * np.pi * np.arange(count) / count
        centres = 6 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
        xyz = random.uniform(-1.5, 1.5, (CLOUD if kind == "cloud" else POINTS * count, 3))
    cameras = []
    for turn, centre in zip(angle, centres, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        pose[:3, 3] = -pose[:3, :3] @ centre
        cameras.append(Camera(WIDTH, HEIGHT, WIDTH, WIDTH, WIDTH / 2, HEIGHT / 2, world_to_camera=pose))
    points = PointCloud(xyz, random.random((len(xyz), 3), dtype=np.float32), np.full(len(xyz), 0.5, np.float32))
    if kind != "cloud":
        inside = [np.flatnonzero(camera.inside(camera.project(xyz)[0])) for camera in cameras]
        points = points.with_sightings([np.sort(random.permutation(index)[:SEEN]) for index in inside])
    images = random.random((count, HEIGHT, WIDTH, 3), dtype=np.float32)
    named = zip(cameras, images, strict=True)
    return TrainingSet(tuple(TrainingView(f"v{number}", *view) for number, view in enumerate(named)), points)


def sources(given: TrainingSet) -> None:
    """Which views stereo matches."""
    from dofbench.training.common.priors.stereo_sources import choose_sources

    choose_sources(given, 4)


def bounds(given: TrainingSet) -> None:
    """Between which disparities stereo looks."""
    from dofbench.training.common.priors.stereo import disparity_bounds

    disparity_bounds(given)


def facts(given: TrainingSet) -> None:
    """What a plan looks at in the photographs, gains among it."""
    from dofbench.methods.stages.facts import facts_of

    facts_of(given, one_lens=True)


def geometry(given: TrainingSet) -> None:
    """What a dataset writes of cameras and points, and reading it again."""
    from dofbench.scenes.export import write_colmap, write_transforms
    from dofbench.scenes.readers.colmap import read_model

    cameras, names = [view.camera for view in given.views], [f"{view.name}.png" for view in given.views]
    with tempfile.TemporaryDirectory() as folder:
        write_colmap(Path(folder), names, cameras, given.points)
        write_transforms(Path(folder, "transforms.json"), names, cameras)
        read_model(Path(folder, "sparse", "0"))


PARTS: dict[str, Callable[[TrainingSet], None]] = {part.__name__: part for part in (sources, bounds, facts, geometry)}


def measure(part: str, kind: str, views: int) -> Row:
    """One case, in a process of its own: median time, and how much memory it takes beyond the scene."""
    given = scene(views, kind)
    PARTS[part](scene(4, kind))  # imports
    before, times = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, []
    while len(times) < REPEATS and sum(times) < ENOUGH:
        start = time.process_time()
        PARTS[part](given)
        times.append(time.process_time() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds = statistics.median(times)
    return {
        "part": part,
        "scene": kind,
        "views": views,
        "processor_s": round(seconds, 4),
        "extra_mib": round((peak - before) / 1024, 1),
    }


def kept(file: Path) -> dict[Case, Row]:
    """The rows that the file has, by case."""
    if not file.is_file():
        return {}
    with file.open(encoding="utf-8", newline="") as stream:
        return {(row["part"], row["scene"], int(row["views"])): row for row in csv.DictReader(stream)}


def main() -> None:
    """Measure, and write the CSV after every case; rows of other cases stay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of growth.csv")
    parser.add_argument("--only", nargs="*", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--missing", action="store_true", help="leave out cases that the file has")
    asked = parser.parse_args()
    file = asked.out / "growth.csv"
    rows, order = kept(file), list(product(PARTS, ("row", "round", "cloud"), VIEWS))
    for case in order:
        if case[0] not in asked.only or (asked.missing and case in rows):
            continue
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            rows[case] = pool.submit(measure, *case).result()
        print(rows[case], flush=True)
        write_csv(file, tuple(rows[case]), [rows[one] for one in order if one in rows])


if __name__ == "__main__":
    main()
