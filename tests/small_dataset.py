"""A small dataset on disk, of a scene that a formula gives, for the tests of the harness and of the reports."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from made_up import cloud, frontal

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.evidence import Role
from dofbench.core.files import sha256_file, sha256_text, write_json
from dofbench.core.images import from_8bit, to_8bit, write_exr, write_png
from dofbench.core.lens import DisparityRange, Lens, SceneRenderer
from dofbench.datasets.format import layout
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.schema import (
    ALL_KNOWN,
    LENS_FILE,
    MANIFEST,
    SCHEMA,
    SOME_UNKNOWN,
    STATED,
    DepthRecord,
    FileRecord,
    LensFile,
    Manifest,
    ShapeRecord,
    SourceImage,
    SourceRecord,
    ThinLensRecord,
    UnknownLens,
    UnknownLensFile,
    ViewRecord,
    as_json,
)
from dofbench.scenes import export
from dofbench.scenes.scene import Split

WIDTH, HEIGHT, FOCAL = 64, 48, 200.0
RANGE = DisparityRange(0.1, 0.6)
_THIN_LENS = ThinLensRecord(recipe="attic", seed=20261104, samples=512, mitsuba="0", variant="scalar_rgb")


def smooth_image(seed: int, camera: Camera) -> np.ndarray:
    """The fake scene seen by a camera through a lens: smooth waves, darker for every second camera."""
    return from_8bit(to_8bit(_light(camera) * _waves(seed, camera)))


def sharp_image(seed: int, camera: Camera) -> np.ndarray:
    """The scene without a lens, which has fine detail besides. The fake method knows both."""
    random = np.random.default_rng(seed)
    squares = (
        random.uniform(size=(-(-camera.height // 4), -(-camera.width // 4), 1)).repeat(4, axis=0).repeat(4, axis=1)
    )
    detail = squares[: camera.height, : camera.width]
    return from_8bit(to_8bit(_light(camera) * (0.5 * _waves(seed, camera) + 0.5 * detail)))


def _waves(seed: int, camera: Camera) -> np.ndarray:
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    phase = seed + camera.world_to_camera[0, 3]
    waves = [np.sin(x / (7 + 3 * c) + phase) * np.cos(y / (9 - 2 * c) - phase) for c in range(3)]
    return 0.5 + 0.4 * np.stack(waves, axis=2)


def _light(camera: Camera) -> float:
    return 0.7 if round(camera.world_to_camera[0, 3]) % 2 else 1.0


def write_dataset(
    folder: Path,
    *,
    name: str = "waves",
    seed: int = 1,
    train: int = 4,
    test: int = 2,
    in_focus: bool = False,
    points: bool = True,
    assign: str = "per-view",
    exact: bool = True,
    unknown: Sequence[str] = (),
    blurred: Sequence[str] = (),
    flat: Sequence[str] = (),
    role: Role | None = None,
    role_by: str | None = None,
    renderer: SceneRenderer = "scatter",
    stated: PointsRecord | None = None,
) -> Path:
    """Write a small dataset of views v0, v1, ..., the test views first; returns the folder.

    Of the scene a lens shows `smooth_image`, darkened by the aperture, and so does the fake method. in_focus: the
    shallow photographs have all the detail of the sharp ones. exact: whether the depth is the scene's own, or
    estimated. unknown, blurred, flat: the views without a known lens, a sharp photograph, depth. stated: where the
    points come from, None for an older dataset, which doesn't say. role, role_by: as the manifest states them.
    renderer: what the lenses' file says that took the photographs.
    """
    shutil.rmtree(folder, ignore_errors=True)
    names = [f"v{index}" for index in range(test + train)]
    splits: list[Split] = ["test" if index < test else "train" for index in range(test + train)]
    cameras = [_camera(index) for index in range(test + train)]
    depth = np.linspace(2.0, 9.0, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    shallow = sharp_image if in_focus else smooth_image
    for index, (view, camera) in enumerate(zip(names, cameras, strict=True)):
        write_png(layout.shallow_path(folder, view), shallow(seed, camera) * (1 - 0.1 * _lens(index).aperture))
        if view not in blurred:
            write_png(layout.sharp_path(folder, view), sharp_image(seed, camera))
        if view not in flat:
            write_exr(layout.depth_path(folder, view), depth)
    images = [layout.relative(layout.shallow_path, view) for view in names]
    sparse = _points(len(cameras)) if points else None
    export.write_colmap(folder, [Path(file).name for file in images], cameras, sparse)
    export.write_transforms(folder / layout.TRANSFORMS, images, cameras, splits=splits)
    lenses = _lens_file(dict(zip(names, splits, strict=True)), unknown, flat, renderer)
    write_json(folder / LENS_FILE, as_json(lenses))
    files = {
        file.relative_to(folder).as_posix(): FileRecord(sha256=sha256_file(file), size=file.stat().st_size)
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
    source = SourceRecord(
        scene=name.split("_")[0],
        layout="none",
        geometry=sha256_text(name),
        images=tuple(
            SourceImage(view=view, sha256=sha256_text(view), photograph="shallow" if view in unknown else None)
            for view in names
        ),
        role=role,
        role_by=role_by,
    )
    measured = DepthRecord(source="given" if exact else "sfm", provenance={}) if set(names) - set(flat) else None
    record = Manifest(
        schema=SCHEMA,
        version=STATED if stated else SOME_UNKNOWN if unknown or measured is None else ALL_KNOWN,
        name=name,
        dofbench="0",
        command="none",
        identity=sha256_text(name),
        seed=seed,
        settings={"assign": assign},
        source=source,
        depth=measured,
        points=stated,
        files=files,
    )
    write_json(folder / MANIFEST, as_json(record))
    return folder


def _camera(index: int) -> Camera:
    return frontal(WIDTH, HEIGHT, FOCAL, (-index, 0.0, 0.0))


def _lens(index: int) -> Lens:
    return Lens(aperture=(0.5, 1.0)[index % 2], focus=(0.2, 0.5, 0.8)[index % 3])


def _points(views: int) -> PointCloud:
    """Points far away, so that every view sees all, and numerous enough to estimate the blur of the photographs."""
    across, down = np.meshgrid(np.linspace(-10.0, 10.0, 16), np.linspace(-10.0, 10.0, 10))
    xyz = np.stack([across.ravel() - 2.5, down.ravel(), np.full(across.size, 100.0)], axis=1)
    return cloud(xyz, [np.arange(views) for _ in xyz], rgb=np.full(xyz.shape, 0.5))


def _lens_file(
    splits: dict[str, Split], unknown: Sequence[str], flat: Sequence[str], renderer: SceneRenderer
) -> LensFile | UnknownLensFile:
    measured = bool(splits.keys() - set(flat))
    records = []
    for index, (view, split) in enumerate(splits.items()):
        lens, physical = _lens(index), _lens(index).physical(RANGE, WIDTH)
        known = ViewRecord(
            name=view,
            split=split,
            aperture=lens.aperture,
            focus=lens.focus,
            k_px=0.02 * WIDTH * lens.aperture,
            aperture_scene=physical.aperture,
            focus_scene=1 / physical.focus_disparity,
            max_coc_px=4.0,
        )
        records.append(UnknownLens(name=view, split=split, lens="unknown") if view in unknown else known)
    if splits and splits.keys() <= set(unknown):
        return UnknownLensFile(disparity_range=(RANGE.q_min, RANGE.q_max) if measured else None, views=tuple(records))
    return LensFile(
        disparity_range=(RANGE.q_min, RANGE.q_max),
        normaliser="scene",
        gamma=2.2,
        alpha=4.0,
        energy="area",
        shape=ShapeRecord(blades=0, rotation=0.0, curvature=0.0, obstruction=0.0),
        renderer=renderer,
        thinlens=_THIN_LENS if renderer == "thinlens" else None,
        views=tuple(records),
    )
