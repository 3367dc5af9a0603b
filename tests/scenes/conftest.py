"""Small made-up scenes for the readers' tests: cameras around a cloud of points, with images."""

from __future__ import annotations

import numpy as np
import pytest
from transforms_file import FILES

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.images import write_png
from dofbench.scenes.export import write_transforms

SIZE = (48, 36)


def _rotation(axis_angle):
    angle = np.linalg.norm(axis_angle)
    if angle == 0:
        return np.eye(3)
    x, y, z = axis_angle / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _cameras(count=5, *, seed=0, size=SIZE, square=True):
    rng = np.random.default_rng(seed)
    width, height = size
    cameras = []
    for _ in range(count):
        pose = np.eye(4)
        pose[:3, :3] = _rotation(rng.normal(0, 0.05, 3))
        pose[:3, 3] = rng.normal(0, 0.2, 3)
        f = 1.1 * width
        cx, cy = (width / 2, height / 2) if square else (0.47 * width, 0.52 * height)
        cameras.append(Camera(width, height, f, f if square else 1.02 * f, cx, cy, pose))
    return cameras


def _cloud(cameras, count=40, *, tracks=True, seed=1):
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(4, 6, count)])
    views = None
    if tracks:
        inside = []
        for camera in cameras:
            pixels, _ = camera.project(xyz)
            inside.append(((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(axis=1))
        views = tuple(np.flatnonzero(seen) for seen in np.array(inside).T)
    rgb = rng.integers(0, 256, (count, 3)).astype(np.float32) / np.float32(255)
    return PointCloud(xyz, rgb, rng.uniform(0, 1, count).astype(np.float32), views)


def _write_images(folder, names, size=SIZE):
    for index, name in enumerate(names):
        image = np.full((size[1], size[0], 3), index / max(1, len(names)), dtype=np.float32)
        write_png(folder / name, image)


@pytest.fixture(scope="session")
def make_cameras():
    """`make_cameras(count, seed=, size=, square=)`: cameras that look along z, a little apart."""
    return _cameras


@pytest.fixture(scope="session")
def make_cloud():
    """`make_cloud(cameras, count, tracks=)`: points in front of these cameras."""
    return _cloud


@pytest.fixture(scope="session")
def write_images():
    """`write_images(folder, names, size)`: one grey PNG a name."""
    return _write_images


@pytest.fixture
def transforms_folder(tmp_path, make_cameras, write_images):
    """Four views of 48x36 with shared intrinsics."""
    write_images(tmp_path, FILES)
    write_transforms(tmp_path / "transforms.json", FILES, make_cameras(4))
    return tmp_path
