"""Writes the files of a dataset that cover all views. Every file is written atomically."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import asdict
from pathlib import Path

import numpy as np

from dofbench import __version__
from dofbench.core.cameras import NO_OFFSET, Offset
from dofbench.core.digests import write_with_digest
from dofbench.core.files import sha256_file, write_json, write_text
from dofbench.core.image_files.exif import EXIF_FILE, write_exif
from dofbench.core.images import image_size, read_exr, read_image, to_8bit, write_png
from dofbench.core.lens import DisparityRange
from dofbench.datasets.format import layout
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.schema import (
    LENS_FILE,
    MANIFEST,
    SCHEMA,
    SIGNED,
    DepthRecord,
    FileRecord,
    LensFile,
    Manifest,
    SensorRecord,
    SourceRecord,
    UnknownLens,
    UnknownLensFile,
    ViewRecord,
    as_json,
)
from dofbench.datasets.synthesis.contact_sheet import (
    PhotographRow,
    SheetRow,
    choose_photographs,
    choose_rows,
    contact_sheet,
)
from dofbench.datasets.synthesis.contact_sheet import photographs_sheet as draw_photographs
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.readme import dataset_readme
from dofbench.datasets.synthesis.render_views import Photography
from dofbench.datasets.synthesis.sheet_drawing import thumb_size
from dofbench.runtime.view_threads import over_views
from dofbench.scenes import export
from dofbench.scenes.scene import Scene, SceneView

SHEET, README = "contact_sheet.png", "README.md"


def lens_file(root: Path, shared: Photography, records: Sequence[ViewRecord]) -> None:
    """Write lens.json."""
    lenses = LensFile(
        disparity_range=(shared.disparity_range.q_min, shared.disparity_range.q_max),
        normaliser="view" if shared.per_view else "scene",
        **LensFile.of_blur(shared.blur),
        thinlens=shared.thinlens,
        light_field=shared.light_field,
        sensor=SensorRecord(**asdict(shared.sensor), bits=shared.bits),
        views=tuple(records),
    )
    write_json(root / LENS_FILE, as_json(lenses))


def unknown_lens_file(root: Path, scene: Scene, disparity_range: DisparityRange | None) -> None:
    """Write lens.json of photographs of unknown lens. disparity_range: that of the depth, None without depth."""
    ends = None if disparity_range is None else (disparity_range.q_min, disparity_range.q_max)
    views = tuple(UnknownLens(name=view.name, split=view.split, lens="unknown") for view in scene.views)
    write_json(root / LENS_FILE, as_json(UnknownLensFile(disparity_range=ends, views=views)))


def exif_file(root: Path, scene: Scene) -> None:
    """Write exif.json with the views that have EXIF; no file if none has."""
    known = {view.name: view.exif for view in scene.views if view.exif is not None}
    if known:
        write_exif(root, known)


def sheet(root: Path, title: str, records: Sequence[ViewRecord], disparity_range: DisparityRange, at_once: int) -> None:
    """Draw the contact sheet from the files of a few views, `at_once` at a time."""

    def read(record: ViewRecord) -> SheetRow:
        return SheetRow(
            record=record,
            sharp=to_8bit(read_image(layout.sharp_path(root, record.name))),
            depth=read_exr(layout.depth_path(root, record.name)),
            shallow=to_8bit(read_image(layout.shallow_path(root, record.name))),
        )

    chosen = choose_rows(records)
    size = thumb_size(*image_size(layout.sharp_path(root, chosen[0].name)))
    write_png(root / SHEET, contact_sheet(title, chosen, read, size, disparity_range, at_once))


def photographs_sheet(
    root: Path, scene: Scene, measured: Set[str], disparity_range: DisparityRange | None, at_once: int
) -> None:
    """Draw the contact sheet of photographs of unknown lens. measured: the views that have depth. at_once: views at a
    time."""

    def read(view: SceneView) -> PhotographRow:
        sharp = view.photograph == "all-in-focus"
        return PhotographRow(
            name=view.name,
            split=view.split,
            photograph=to_8bit(read_image(layout.shallow_path(root, view.name))),
            sharp=to_8bit(read_image(layout.sharp_path(root, view.name))) if sharp else None,
            depth=read_exr(layout.depth_path(root, view.name)) if view.name in measured else None,
        )

    chosen = choose_photographs(scene)
    title = f"{scene.name}: {len(scene.views)} views, lens unknown"
    size = thumb_size(*image_size(layout.shallow_path(root, chosen[0].name)))
    write_png(root / SHEET, draw_photographs(title, chosen, read, size, disparity_range, at_once))


def readme(
    root: Path,
    scene: Scene,
    settings: MakeDataset,
    source: SourceRecord,
    depth: DepthRecord,
    points: PointsRecord,
    records: Sequence[ViewRecord],
    notes: Sequence[str],
    shared: Photography,
) -> None:
    """Write the dataset's README. notes: what the layouts can't represent."""
    write_text(root / README, dataset_readme(scene, settings, source, depth, points, records, notes, shared))


def expected_files(root: Path, source: SourceRecord, depth: DepthRecord | None) -> list[str]:
    """Names, relative to the folder, of all files of a dataset of these views except the manifest; sorted.

    depth: tells whether there are confidence maps, which older datasets lack, and which photographs have depth.
    """
    measured = {record.view for record in depth.views} if depth is not None else set()
    views = []
    for image in source.images:
        if image.photograph is None:
            patterns = [
                layout.SHALLOW,
                layout.LINEAR,
                layout.SHARP,
                layout.DEPTH,
                *([layout.CONFIDENCE] if measured else []),
                *([layout.SHARP_LINEAR] if image.linear else []),
            ]
        else:
            patterns = [
                layout.SHALLOW,
                *([layout.SHARP] if image.photograph == "all-in-focus" else []),
                *([layout.DEPTH, layout.CONFIDENCE] if image.view in measured else []),
            ]
        views += [pattern.format(image.view) for pattern in (*patterns, *([layout.MASK] if image.mask else []))]
    sparse = root / layout.SPARSE
    files = [path for path in sparse.iterdir() if path.is_file()] if sparse.is_dir() else []
    model = [path.relative_to(root).as_posix() for path in files if not path.name.startswith(".")]
    # Photographs without depth and points have no depth bounds, hence no poses_bounds.npy.
    unbounded = (
        all(image.photograph is not None for image in source.images) and not (root / layout.POSES_BOUNDS).is_file()
    )
    bounds = [] if unbounded else [layout.POSES_BOUNDS]
    exif = [EXIF_FILE] if (root / EXIF_FILE).is_file() else []
    return sorted([*views, *model, *bounds, *exif, LENS_FILE, layout.TRANSFORMS, SHEET, README])


def manifest(
    root: Path,
    *,
    name: str,
    settings: MakeDataset,
    recipe: Mapping[str, object],
    source: SourceRecord,
    depth: DepthRecord | None,
    points: PointsRecord,
    identity: str,
    offset: Offset,
    at_once: int,
) -> None:
    """Write dataset.json with all files of the folder, which makes the dataset complete. recipe: the settings to
    record. offset: the scene's. at_once: files to read at a time."""

    def record_of(file: str) -> FileRecord:
        return FileRecord(sha256=sha256_file(root / file), size=(root / file).stat().st_size)

    names = expected_files(root, source, depth)
    files = dict(zip(names, over_views(record_of, names, at_once), strict=True))
    record = Manifest(
        schema=SCHEMA,
        version=SIGNED,
        name=name,
        dofbench=__version__,
        command=settings.command(settings.scene or name),
        identity=identity,
        seed=settings.seed,
        settings=dict(recipe),
        source=source,
        depth=depth,
        points=points,
        offset=None if offset == NO_OFFSET else offset,
        files=files,
    )
    write_with_digest(root / MANIFEST, as_json(record))


def geometry(root: Path, scene: Scene, near_far: np.ndarray | None, measured: Set[str] | None = None) -> list[str]:
    """Write the cameras, at this size, and the points: a COLMAP model, poses_bounds.npy, transforms.json;
    with the scene's offset added back.

    near_far: (N, 2), scene units, of the views in the scene's order; None for no poses_bounds.npy. measured: the views
    that have depth, None for all. Returns lines on what poses_bounds.npy can't represent.
    """
    cameras = [view.camera for view in scene.views]
    files = [layout.relative(layout.shallow_path, view.name) for view in scene.views]
    export.write_colmap(root, [Path(file).name for file in files], cameras, scene.points, scene.offset)
    export.write_transforms(
        root / layout.TRANSFORMS,
        files,
        cameras,
        splits=[view.split for view in scene.views],
        depth_paths=[
            layout.relative(layout.depth_path, view.name) if measured is None or view.name in measured else None
            for view in scene.views
        ],
        extra=[_mask_entry(root, view.name) for view in scene.views],
        offset=scene.offset,
    )
    if near_far is None:
        return []
    # Rows are in the order of sorted file names: "a-b.png" comes before "a.png", although "a" comes before "a-b".
    order = sorted(range(len(files)), key=files.__getitem__)
    ordered = [cameras[index] for index in order]
    return export.write_poses_bounds(root / layout.POSES_BOUNDS, ordered, near_far[order], scene.offset)


def _mask_entry(root: Path, name: str) -> dict[str, str]:
    """What transforms.json says of a view's mask, as nerfstudio reads it; nothing without one."""
    return {"mask_path": layout.relative(layout.mask_path, name)} if layout.mask_path(root, name).is_file() else {}
