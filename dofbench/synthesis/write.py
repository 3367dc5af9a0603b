"""What stands where in a dataset folder, and the files that hold for all views. Every function is atomic a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from dofbench import __version__
from dofbench.files import sha256_file, write_json, write_text
from dofbench.images import read_exr, read_image, to_8bit, write_png
from dofbench.lens import DisparityRange
from dofbench.scenes import export
from dofbench.scenes.types import Scene
from dofbench.synthesis.readme import readme_text
from dofbench.synthesis.render import Blur
from dofbench.synthesis.schema import (
    LENS_FILE,
    MANIFEST,
    SCHEMA,
    VERSION,
    DepthRecord,
    FileRecord,
    LensFile,
    Manifest,
    SensorRecord,
    ShapeRecord,
    SourceRecord,
    ThinLensRecord,
    ViewRecord,
    as_json,
)
from dofbench.synthesis.settings import MakeDataset
from dofbench.synthesis.sheet import SheetRow, choose_rows, contact_sheet

SHEET, README = "contact_sheet.png", "README.md"
TRANSFORMS, POSES_BOUNDS, SPARSE = "transforms.json", "poses_bounds.npy", "sparse/0"
_SHALLOW, _LINEAR, _SHARP, _DEPTH = "images/{}.png", "images_linear/{}.exr", "all_in_focus/{}.png", "depth/{}.exr"
_CONFIDENCE = "confidence/{}.png"


def shallow_path(root: Path, name: str) -> Path:
    """The view's shallow photograph, encoded, 8 bit."""
    return root / _SHALLOW.format(name)


def linear_path(root: Path, name: str) -> Path:
    """The view's shallow photograph before encoding."""
    return root / _LINEAR.format(name)


def sharp_path(root: Path, name: str) -> Path:
    """The view's all-in-focus photograph, encoded, 8 bit."""
    return root / _SHARP.format(name)


def depth_path(root: Path, name: str) -> Path:
    """The view's z-depth, float32, scene units."""
    return root / _DEPTH.format(name)


def confidence_path(root: Path, name: str) -> Path:
    """The confidence of the view's depth, 8 bit: 0 unknown ... 255 certain."""
    return root / _CONFIDENCE.format(name)


def relative(place: Callable[[Path, str], Path], name: str) -> str:
    """A view's file, by one of the functions above, relative to the dataset's folder."""
    return place(Path(), name).as_posix()


def lens_file(root: Path, blur: Blur, records: Sequence[ViewRecord]) -> None:
    """Write lens.json."""
    lenses = LensFile(
        disparity_range=(blur.disparity_range.q_min, blur.disparity_range.q_max),
        normaliser="view" if blur.per_view else "scene", gamma=blur.gamma, alpha=blur.alpha, energy=blur.energy,
        shape=ShapeRecord(**asdict(blur.shape)), renderer=blur.renderer,
        layers=blur.layers if blur.renderer == "layered" else None, thinlens=blur.thinlens,
        sensor=SensorRecord(**asdict(blur.sensor), bits=blur.bits), views=tuple(records),
    )
    write_json(root / LENS_FILE, as_json(lenses))


def sheet(root: Path, title: str, records: Sequence[ViewRecord], disparity_range: DisparityRange) -> None:
    """Draw the contact sheet from the files of a few views."""
    rows = [
        SheetRow(
            record=record, sharp=to_8bit(read_image(sharp_path(root, record.name))),
            depth=read_exr(depth_path(root, record.name)), shallow=to_8bit(read_image(shallow_path(root, record.name))),
        )
        for record in choose_rows(records)
    ]
    write_png(root / SHEET, contact_sheet(title, rows, disparity_range))


def readme(
    root: Path, scene: Scene, settings: MakeDataset, source: SourceRecord, depth: DepthRecord,
    records: Sequence[ViewRecord], notes: Sequence[str], thinlens: ThinLensRecord | None,
) -> None:
    """Write the dataset's own README. notes: what the layouts can't hold. thinlens: of the renderer of that name."""
    write_text(root / README, readme_text(scene, settings, source, depth, records, notes, thinlens))


def expected_files(root: Path, names: Sequence[str], depth: DepthRecord) -> list[str]:
    """Names, relative to the folder, of all files of a dataset of these views but the manifest; sorted.

    depth: says whether there are confidence maps, which older datasets have not.
    """
    patterns = [_SHALLOW, _LINEAR, _SHARP, _DEPTH, *([_CONFIDENCE] if depth.views else [])]
    views = [pattern.format(name) for name in names for pattern in patterns]
    model = [path.relative_to(root).as_posix() for path in (root / SPARSE).iterdir()]
    return sorted([*views, *model, LENS_FILE, POSES_BOUNDS, TRANSFORMS, SHEET, README])


def manifest(
    root: Path, *, name: str, settings: MakeDataset, source: SourceRecord, depth: DepthRecord, identity: str
) -> None:
    """Write dataset.json over all files there, which makes the dataset complete."""
    files = {
        file: FileRecord(sha256=sha256_file(root / file), size=(root / file).stat().st_size)
        for file in expected_files(root, [image.view for image in source.images], depth)
    }
    record = Manifest(
        schema=SCHEMA, version=VERSION, name=name, dofbench=__version__,
        command=settings.command(settings.scene or name), identity=identity, seed=settings.seed,
        settings=settings.recipe(), source=source, depth=depth, files=files,
    )
    write_json(root / MANIFEST, as_json(record))


def geometry(root: Path, scene: Scene, near_far: np.ndarray) -> list[str]:
    """Write the cameras, at this size, and the points: a COLMAP model, poses_bounds.npy, transforms.json.

    near_far: (N, 2), scene units, of the views in the scene's order. Returns what poses_bounds.npy can't hold.
    """
    cameras = [view.camera for view in scene.views]
    files = [relative(shallow_path, view.name) for view in scene.views]
    export.write_colmap(root, [Path(file).name for file in files], cameras, scene.points)
    export.write_transforms(
        root / TRANSFORMS, files, cameras, splits=[view.split for view in scene.views],
        depth_paths=[relative(depth_path, view.name) for view in scene.views],
    )
    # Rows belong to the sorted *files*: "a-b.png" comes before "a.png", though "a" comes before "a-b".
    order = sorted(range(len(files)), key=files.__getitem__)
    return export.write_poses_bounds(root / POSES_BOUNDS, [cameras[index] for index in order], near_far[order])
