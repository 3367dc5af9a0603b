"""Accuracy of depthnet, compared with a constant per view and with completed sparse points.

    python datasets/depthnet/evaluate.py --rooms WORK/held --scenes fern=DIR --out datasets/depthnet/accuracy.csv

Held-out rooms and the built-in scene are compared with exact depth; other scenes with every fifth sparse point, which
the estimates don't use. Prints a row for each scene and estimate, and writes them as CSV.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from dofbench.core.content import content_folder
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.files import write_csv
from dofbench.datasets.synthesis.depth_sources import open_source
from dofbench.scenes import load_scene
from dofbench.scenes.depth.align import fit
from dofbench.scenes.depth.network import Network, find_network, sampled
from dofbench.scenes.depth.sightings import scene_sightings
from dofbench.scenes.depth.source import SourceId
from dofbench.scenes.scene import Scene

HELD_OUT = 5  # one point in so many is held out
FIELDS = ("scene", "estimate", "abs_rel", "within_1_25", "median_error")
ALIGNING = 300  # number of pixels of a held-out room to which the network is aligned, in place of sparse points


@dataclass(frozen=True)
class Settings:
    """What to evaluate on."""

    rooms: Path | None = None
    """Folder of held-out rooms (render.py --first 1000000)."""
    scenes: tuple[str, ...] = ()
    """NAME=FOLDER of scenes with sparse points."""
    network: str = "depthnet"
    """The network: a file, or the name of the shipped one."""
    width: int = 504
    """Width at which the scenes are read, pixels."""
    out: Path = Path("accuracy.csv")
    """The table."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Estimated and true disparities of some pixels, (P,) each."""

    found: np.ndarray
    true: np.ndarray

    def row(self) -> list[str]:
        """Cells with AbsRel of depth, share within 1.25, median relative error of disparity."""
        found, true = np.maximum(self.found, 0.1 * np.percentile(self.true, 1)), self.true
        ratio = np.maximum(found / true, true / found)
        return [
            f"{np.mean(np.abs(true / found - 1)):.3f}",
            f"{np.mean(ratio < 1.25):.3f}",
            f"{np.median(np.abs(found / true - 1)):.3f}",
        ]


def main(settings: Settings) -> None:
    """Print and write the table."""
    rows: list[list[str]] = []
    file = find_network(settings.network)
    if settings.rooms is not None:
        rows += _rows("held-out rooms", _rooms(settings.rooms, file))
    rows += _rows("tabletop (built-in)", _exact(load_scene(content_folder("datasets") / "tabletop"), file))
    for entry in settings.scenes:
        name, _, folder = entry.partition("=")
        rows += _rows(f"{name}, held-out points", _points(load_scene(Path(folder), width=settings.width), file))
    write_csv(settings.out, FIELDS, [dict(zip(FIELDS, row, strict=True)) for row in rows])


def _rows(scene: str, results: dict[str, list[Errors]]) -> list[list[str]]:
    rows = []
    for estimate, parts in results.items():
        whole = Errors(np.concatenate([part.found for part in parts]), np.concatenate([part.true for part in parts]))
        rows.append([scene, estimate, *whole.row()])
        print(", ".join(rows[-1]), flush=True)
    return rows


def _rooms(folder: Path, file: Path) -> dict[str, list[Errors]]:
    """Errors on rooms, with every view aligned to some hundred pixels of its true depth; the constant is their
    median."""
    network, rng = Network(file), np.random.default_rng(0)
    results: dict[str, list[Errors]] = {"constant per view": [], "depthnet": []}
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as room:
            views = list(zip(room["images"], room["depth"].astype(np.float64), strict=True))
        for number, (image, depth) in enumerate(views):
            rows, columns = np.nonzero(depth > 0)
            if len(rows) < 2 * ALIGNING:
                continue
            chosen = rng.choice(len(rows), ALIGNING, replace=False)
            xy = np.stack([columns[chosen] + 0.5, rows[chosen] + 0.5], axis=1)
            truth = 1 / depth[rows[chosen], columns[chosen]]
            output = network.predict(image.astype(np.float32) / 255, f"{path.stem}/{number}")
            height, width = depth.shape
            alignment = fit(sampled(output, xy, width, height), truth, np.ones(ALIGNING), "disparity", "scale-shift")
            every = np.stack([columns + 0.5, rows + 0.5], axis=1)
            true = 1 / depth[rows, columns]
            constant = np.full(len(true), np.median(truth))
            # If the network can't be aligned, the constant is used.
            everywhere = sampled(output, every, width, height)
            found = constant if alignment is None else alignment.disparity(everywhere, "disparity")
            results["constant per view"].append(Errors(constant, true))
            results["depthnet"].append(Errors(found, true))
    return results


def _sources(scene: Scene, file: Path) -> Iterable[tuple[str, dict[str, np.ndarray]]]:
    """Each estimate's name, and its disparity maps by view."""
    sightings = scene_sightings(scene, "the constant").by_view
    sizes = {view.name: (view.camera.height, view.camera.width) for view in scene.views}
    yield "constant per view", {n: np.full(sizes[n], np.median(sightings[n].disparity)) for n in sizes}
    kinds: tuple[tuple[SourceId, str], ...] = (("sfm", "sfm"), ("onnx", "depthnet"))
    for kind, label in kinds:
        with tempfile.TemporaryDirectory() as work:
            try:
                source = open_source(kind, scene, steps=1, seed=0, work=Path(work), network=file)
            except InputError as refusal:
                print(f"{scene.name}, {label}: refused: {refusal.found}", flush=True)
                continue
            yield label, {view.name: 1.0 / source.estimate(view).depth.astype(np.float64) for view in scene.views}


def _exact(scene: Scene, file: Path) -> dict[str, list[Errors]]:
    results: dict[str, list[Errors]] = {}
    for label, maps in _sources(scene, file):
        results[label] = []
        for view in scene.views:
            assert view.depth is not None
            depth = view.depth().astype(np.float64)
            known = depth > 0
            results[label].append(Errors(maps[view.name][known], 1 / depth[known]))
    return results


def _points(scene: Scene, file: Path) -> dict[str, list[Errors]]:
    points = scene.points
    assert points is not None, "the scene has no points"
    held = np.arange(len(points)) % HELD_OUT == 0
    rest, test = (_part(points, chosen) for chosen in (~held, held))
    truth = scene_sightings(replace(scene, points=test), "evaluation").by_view
    results: dict[str, list[Errors]] = {}
    for label, maps in _sources(replace(scene, points=rest), file):
        results[label] = []
        for view in scene.views:
            xy = truth[view.name].xy
            found = maps[view.name][xy[:, 1].astype(int), xy[:, 0].astype(int)]
            results[label].append(Errors(found, truth[view.name].disparity))
    return results


def _part(points: PointCloud, chosen: np.ndarray) -> PointCloud:
    tracks = None if points.views is None else tuple(points.views[index] for index in np.flatnonzero(chosen))
    return PointCloud(points.xyz[chosen], points.rgb[chosen], points.error[chosen], tracks)


if __name__ == "__main__":
    main(tyro.cli(Settings))
