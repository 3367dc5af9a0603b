"""A tiny scene with exact depth: two textured planes, one in front of the other, seen by a row of cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import cloud, frontal

from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.images import write_exr, write_png
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import make_dataset, sheet_drawing
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes import export

USUAL_THUMB = sheet_drawing._THUMB
THUMB = USUAL_THUMB // 2
VIEWS, WIDTH, HEIGHT, NEAR, FAR = 6, 128, 96, 2.0, 7.0
TEST_VIEWS, SEEN_BY = (0, 3), (0, 1, 2, 4)


def _camera(index: int) -> Camera:
    return frontal(WIDTH, HEIGHT, 120.0, (0.1 * index - 0.25, -0.02 * index, -0.1))


def _texture(x: np.ndarray, y: np.ndarray, plane: np.ndarray) -> np.ndarray:
    wave = np.sin(9 * x + 2 * plane) * np.cos(7 * y) > 0
    stripes = np.sin(np.stack([5 * x + y, 4 * y - x, 6 * x + 3 * y], axis=-1))
    return np.clip(0.45 + 0.3 * stripes + 0.2 * wave[..., None], 0.0, 1.0).astype(np.float32)


def _render(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Image (H, W, 3) and z-depth (H, W): the near plane covers world x < 0.1, the far one the rest."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    offset = -camera.world_to_camera[:3, 3]

    def plane_at(world_z: float) -> tuple[np.ndarray, np.ndarray, float]:
        z = world_z - offset[2]
        x, y = camera.rays(columns, rows)
        return x * z + offset[0], y * z + offset[1], z

    near_x, near_y, near = plane_at(NEAR)
    far_x, far_y, far = plane_at(FAR)
    front = near_x < 0.1
    x, y = np.where(front, near_x, far_x), np.where(front, near_y, far_y)
    return _texture(x, y, front.astype(float)), np.where(front, near, far).astype(np.float32)


@pytest.fixture
def one_torch_thread() -> Iterator[None]:
    """The reference scatter on images this small spends its time waking threads, the more the busier the machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def write_scene() -> Callable[..., Path]:
    """`write_scene(folder, depth=True, points=True, offset=)`: write the scene in nerfstudio's layout, with a COLMAP
    model; with all positions moved by an offset."""

    def write(folder: Path, depth: bool = True, points: bool = True, offset: Offset = NO_OFFSET) -> Path:
        names = [f"images/v{index:02d}.png" for index in range(VIEWS)]
        depths = [f"depth/v{index:02d}.exr" for index in range(VIEWS)]
        cameras = [_camera(index) for index in range(VIEWS)]
        for name, depth_name, camera in zip(names, depths, cameras, strict=True):
            image, z = _render(camera)
            write_png(folder / name, image)
            if depth:
                write_exr(folder / depth_name, z)
        generator = np.random.default_rng(0)
        xy = generator.uniform(-0.4, 0.4, (20, 2))
        xyz = np.column_stack([xy, np.full(20, NEAR)])
        # Points 0 ... 3 are seen by test views alone.
        tracks = tuple(np.array(TEST_VIEWS if index < 4 else SEEN_BY) for index in range(20))
        points_of = cloud(xyz, tracks, np.full((20, 3), 0.5), error=0.5)
        export.write_colmap(folder, [Path(name).name for name in names], cameras, points_of if points else None, offset)
        export.write_transforms(
            folder / "transforms.json",
            names,
            cameras,
            depth_paths=depths if depth else None,
            splits=["test" if index in TEST_VIEWS else "train" for index in range(VIEWS)],
            offset=offset,
        )
        return folder

    return write


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory, write_scene: Callable[..., Path]) -> Path:
    """The scene with 6 views, views 0 and 3 held back. Nobody writes to it."""
    return write_scene(tmp_path_factory.mktemp("scenes") / "planes")


@contextmanager
def pictures_of(longest_side: int) -> Iterator[None]:
    """Contact sheets with pictures of this size, pixels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sheet_drawing, "_THUMB", longest_side)
        yield


@pytest.fixture(autouse=True, scope="module")
def _small_contact_sheet() -> Iterator[None]:
    """To write a contact sheet takes half of the time of a dataset this small: its pictures are half as wide here."""
    with pictures_of(THUMB):
        yield


@pytest.fixture(scope="session")
def dataset_folder(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of the scene, all settings at their defaults. Nobody writes to it."""
    with pictures_of(THUMB):
        return _made(scene, tmp_path_factory.mktemp("datasets") / "planes")


@pytest.fixture(scope="session")
def dataset_as_called(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with a contact sheet of the usual size, as another process makes it. Nobody writes to it."""
    with pictures_of(USUAL_THUMB):
        return _made(scene, tmp_path_factory.mktemp("called") / "planes")


def _made(scene: Path, out: Path) -> Path:
    return make_dataset(MakeDataset(scene=str(scene), out=out), progress=Silent())


@pytest.fixture(scope="session")
def contents() -> Callable[[Path], dict[str, bytes]]:
    """`contents(folder)`: the bytes of every file below the folder, by relative name."""

    def read(folder: Path) -> dict[str, bytes]:
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    return read
