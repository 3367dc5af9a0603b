"""Cameras, points and scenes made up for tests, an observer of a training, and a record of called ops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.runtime import ops as kernels
from dofbench.scenes.scene import Scene, SceneView


def frontal(width: int, height: int, focal: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Camera:
    """A camera at this place of the world that looks along z: square pixels, the principal point in the middle."""
    pose = np.eye(4)
    pose[:3, 3] = 0.0 - np.array(at)
    return Camera(width, height, focal, focal, width / 2, height / 2, pose)


def cloud(
    xyz: np.ndarray | Sequence[Sequence[float]],
    views: Sequence[np.ndarray] | None = None,
    rgb: np.ndarray | None = None,
    error: float = 0.0,
) -> PointCloud:
    """Points, (P, 3), black unless told, all of one reprojection error, pixels."""
    where = np.asarray(xyz, np.float64).reshape(-1, 3)
    colours = np.zeros(where.shape) if rgb is None else rgb
    tracks = None if views is None else tuple(views)
    return PointCloud(where, colours.astype(np.float32), np.full(len(where), error, np.float32), tracks)


def scene_of(
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray | None] | None = None,
    image: np.ndarray | None = None,
    points: PointCloud | None = None,
    suffix: str = ".png",
    name: str = "scene",
) -> Scene:
    """A scene that lies in no folder: views v0, v1, ... of one image, black unless told, with these depth maps."""
    views = []
    for index, camera in enumerate(cameras):
        shown = np.zeros((camera.height, camera.width, 3), np.float32) if image is None else image
        depth = None if depths is None else depths[index]
        views.append(
            SceneView(
                f"v{index}",
                camera,
                _reader(shown),
                Path(f"v{index}{suffix}"),
                depth=None if depth is None else _reader(depth),
            )
        )
    return Scene(name, Path(name), "made up", tuple(views), points)


def _reader(array: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: array


class Recorder:
    """An observer that keeps every loss and can stop after some steps."""

    def __init__(self, stop_after: int | None = None):
        self.losses: list[float] = []
        self._stop_after = stop_after

    def seconds(self) -> float:
        """No time passes."""
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        """Go on until the step to stop after."""
        self.losses.append(loss)
        return self._stop_after is None or step < self._stop_after

    def stage(self, name: str, done: int, total: int) -> None:
        """Nothing is shown of it."""


def record_ops(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The kernel ops that are called from now on; the set grows with the calls."""
    called: set[str] = set()

    def implementation(op: str, backend: str, **tensors: Any) -> Any:
        called.add(op)
        return kernels.implementation(op, backend, **tensors)

    for op in kernels.ops():
        monkeypatch.setattr(import_module(f"{kernels.__name__}.{op}.op"), "implementation", implementation)
    return called


def ply_text(xyz):
    """An ASCII PLY file with these points (N, 3)."""
    head = "".join(f"property double {axis}\n" for axis in "xyz")
    rows = "".join(" ".join(map(repr, map(float, row))) + "\n" for row in xyz)
    return f"ply\nformat ascii 1.0\nelement vertex {len(xyz)}\n{head}end_header\n{rows}"
