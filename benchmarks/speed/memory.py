"""Memory of a training by the number of its pixels: memory.csv.

    python -m benchmarks.speed.memory 3dgs lensselect --views 10 30 --width 816 --out reports/speed

Each training has its own process, and a generated dataset: two textured planes, seen by a row of cameras. Rows that the
file has of other cases stay. Columns, MB of 10^6 bytes:

- loaded_mb: resident with the program and the dataset's list of files, before any image
- set_mb: resident with the training set
- first_mb: peak up to the first step, with the depth prior
- peak_mb: peak of the whole training
- bytes_a_pixel: growth of the peak over that of the training pixels, from the row with fewer views; empty in that one
"""

from __future__ import annotations

import csv
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from dofbench.runtime.threads import configure_threads

configure_threads()  # before torch and numba are imported

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import tyro  # noqa: E402

from dofbench.core.budget import Budget  # noqa: E402
from dofbench.core.cameras import Camera  # noqa: E402
from dofbench.core.contracts import PointCloud  # noqa: E402
from dofbench.core.files import replacing, write_csv  # noqa: E402
from dofbench.core.progress import Silent  # noqa: E402
from dofbench.datasets.format.dataset import Dataset  # noqa: E402
from dofbench.datasets.synthesis import make_dataset  # noqa: E402
from dofbench.datasets.synthesis.dataset_options import MakeDataset  # noqa: E402
from dofbench.evaluation.results.provenance import peak_memory_mb, reset_peak_memory  # noqa: E402
from dofbench.evaluation.results.run_spec import parse_overrides  # noqa: E402
from dofbench.methods.cards import find_method  # noqa: E402
from dofbench.runtime.freed_memory import keep_freed_memory  # noqa: E402
from dofbench.scenes.export import write_colmap  # noqa: E402

FIELDS = (
    "method",
    "preset",
    "options",
    "views",
    "width",
    "height",
    "steps",
    "loaded_mb",
    "set_mb",
    "first_mb",
    "peak_mb",
    "bytes_a_pixel",
)
CASE = FIELDS[:7]
FAR, NEAR = 6.0, 3.0  # z of the planes, scene units
SPAN = 2.0  # length of the row of cameras, scene units
POINTS = 4000
Row = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    methods: tyro.conf.Positional[tuple[str, ...]]
    """The methods."""
    out: Path
    """Folder of memory.csv."""
    views: tuple[int, ...] = (10, 30)
    """Training views, one training for each number."""
    width: int = 1632
    """Width of a view, pixels; its height is three quarters."""
    steps: int = 20
    """Steps of the training."""
    preset: str = "cpu"
    """Preset of the methods."""
    set: tuple[str, ...] = ()
    """Options in place of the preset's, as NAME=VALUE."""
    data: Path = Path("memory-data")
    """Folder for the generated datasets, which later calls use again."""


def camera_of(index: int, count: int, width: int) -> Camera:
    """One of a row of cameras that look along z."""
    pose = np.eye(4)
    pose[:3, 3] = SPAN / 2 - SPAN * index / max(count - 1, 1), 0.1 * np.sin(index), 0.0
    height = width * 3 // 4
    return Camera(width, height, 0.9 * width, 0.9 * width, width / 2, height / 2, pose)


def generated(folder: Path, count: int, width: int) -> Path:
    """A dataset of `count` training views and one test view, with sparse points; made unless it is there."""
    scene = folder.with_name(f"{folder.name}-scene")
    cameras = [camera_of(index, count + 1, width) for index in range(count + 1)]
    names = [f"v{index:04d}.png" for index in range(count + 1)]
    random = np.random.default_rng(0)
    textures = [_texture(random) for _ in range(2)]
    (scene / "images").mkdir(parents=True, exist_ok=True)
    for name, camera in zip(names, cameras, strict=True):
        if not (scene / "images" / name).is_file():
            _write(scene / "images" / name, _photograph(camera, textures))
    write_colmap(scene, names, cameras, _points(cameras, textures, random))
    (scene / "test.txt").write_text(names[-1])
    return make_dataset(MakeDataset(scene=str(scene), photographs="shallow", out=folder), progress=Silent())


def _write(path: Path, image: np.ndarray) -> None:
    """Write a PNG without compression, in a twentieth of the time."""
    with replacing(path) as temporary:
        _, coded = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 0])
        temporary.write_bytes(coded.tobytes())


def _texture(random: np.random.Generator) -> np.ndarray:
    """(1024, 1024, 3) uint8: noise at several scales."""
    total = np.zeros((1024, 1024, 3), np.float32)
    for size in (16, 64, 256, 1024):
        total += cv2.resize(random.random((size, size, 3), np.float32), (1024, 1024), interpolation=cv2.INTER_CUBIC)
    return np.clip(total * 64, 0, 255).astype(np.uint8)


def _homography(camera: Camera, z: float) -> np.ndarray:
    """(3, 3), from the texture of the plane at z, 8 scene units wide, to the camera's pixels."""
    corners = np.array([(-4, -4), (4, -4), (4, 4), (-4, 4)], np.float64)
    xy, _ = camera.project(np.concatenate([corners, np.full((4, 1), z)], axis=1))
    pixels = np.array([(0, 0), (1023, 0), (1023, 1023), (0, 1023)], np.float32)
    return cv2.getPerspectiveTransform(pixels, xy.astype(np.float32))


def _photograph(camera: Camera, textures: list[np.ndarray]) -> np.ndarray:
    """(H, W, 3) uint8: the far plane, softer, and in its middle half of the near one."""
    size = camera.width, camera.height
    far, near = (cv2.warpPerspective(textures[k], _homography(camera, z), size) for k, z in enumerate((FAR, NEAR)))
    window = np.zeros((1024, 1024), np.uint8)
    window[448:576, 448:576] = 255
    inside = cv2.warpPerspective(window, _homography(camera, NEAR), size) > 127
    return np.where(inside[..., None], near, cv2.GaussianBlur(far, (0, 0), camera.width / 800))


def _points(cameras: list[Camera], textures: list[np.ndarray], random: np.random.Generator) -> PointCloud:
    """Points of both planes, each seen by at most eight neighbouring cameras."""
    near = np.arange(POINTS) % 4 == 0
    xy = np.where(near[:, None], random.uniform(-0.5, 0.5, (POINTS, 2)), random.uniform(-3.5, 3.5, (POINTS, 2)))
    xyz = np.concatenate([xy, np.where(near, NEAR, FAR)[:, None]], axis=1)
    sees = np.stack([camera.inside(camera.project(xyz)[0]) for camera in cameras], axis=1)
    tracks = []
    for seen in sees:
        views = np.flatnonzero(seen)
        first = int(random.integers(max(len(views) - 7, 1)))
        tracks.append(views[first : first + 8])
    kept = np.array([len(track) > 1 for track in tracks])
    column, row = ((xy + 4) / 8 * 1023).astype(int).T
    colours = np.where(near[:, None], textures[1][row, column], textures[0][row, column]).astype(np.float32) / 255
    return PointCloud(xyz, colours, np.zeros(POINTS, np.float32), tuple(tracks)).kept(kept)


class Watched:
    """An observer that notes the peak at the first step."""

    first_mb = 0.0

    def seconds(self) -> float:
        """No time limit."""
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        """Never ends a training."""
        if step == 1:
            self.first_mb = peak_memory_mb()
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""


def resident_mb() -> float:
    """Resident memory now, MB."""
    reset_peak_memory()
    return peak_memory_mb()


def measured(method_id: str, preset: str, overrides: Row, steps: int, folder: Path) -> Row:
    """Train in this process, which must be fresh; returns the columns of memory."""
    keep_freed_memory()  # as a run does
    entry, dataset = find_method(method_id), Dataset.load(folder)
    _, options, _ = entry.preset(preset)
    method = entry.create({**options, **overrides, "steps": steps}, 0, "cpu")
    row: Row = {"loaded_mb": resident_mb()}
    training_set = dataset.training_set("shallow")
    row["set_mb"] = resident_mb()
    watched = Watched()
    outcome = method.fit(training_set, Budget(steps=steps), watched)
    assert outcome.steps == steps, outcome
    return {**row, "first_mb": watched.first_mb, "peak_mb": peak_memory_mb()}


def in_own_process(*arguments: Any) -> Row:
    """`measured` in a new process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measured, *arguments).result()


def main(settings: Settings) -> None:
    """Measure every method with every number of views."""
    kept, rows = _kept(settings.out / "memory.csv"), list[Row]()
    height, overrides = settings.width * 3 // 4, parse_overrides(settings.set)
    for method_id in settings.methods:
        before: Row | None = None
        for count in sorted(settings.views):
            folder = generated(settings.data / f"{count}-{settings.width}", count, settings.width)
            named = " ".join(settings.set)
            case = (method_id, settings.preset, named, count, settings.width, height, settings.steps)
            if before is None:  # compiling takes memory of its own
                in_own_process(method_id, settings.preset, overrides, 2, folder)
            found = in_own_process(method_id, settings.preset, overrides, settings.steps, folder)
            row: Row = {**dict(zip(CASE, case, strict=True)), **found}
            if before is not None:
                pixels = (count - before["views"]) * settings.width * height
                row["bytes_a_pixel"] = 1e6 * (row["peak_mb"] - before["peak_mb"]) / pixels
            print(row, flush=True)
            rows.append(row)
            before = row
    new = {tuple(str(row[name]) for name in CASE) for row in rows}
    write_csv(
        settings.out / "memory.csv", FIELDS, [*(row for row in kept if tuple(row[n] for n in CASE) not in new), *rows]
    )


def _kept(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


if __name__ == "__main__":
    main(tyro.cli(Settings))
