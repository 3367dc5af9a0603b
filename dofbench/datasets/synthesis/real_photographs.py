"""Makes datasets of real photographs that are shallow already, by an unknown lens; the photographs aren't blurred.

The dataset has the usual layout. Unknown properties are omitted, and lens.json and the manifest mark them: no view has
a lens, a view has a sharp image only if the scene has a sharp photograph, and depth only if the scene has depth.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from dofbench import __version__
from dofbench.core.file_lock import only_writer
from dofbench.core.files import canonical_json, sha256_text, write_text
from dofbench.core.images import write_png
from dofbench.core.lens import DisparityRange
from dofbench.core.progress import Progress
from dofbench.datasets.format import layout
from dofbench.datasets.format.schema import DepthRecord, SourceRecord
from dofbench.datasets.synthesis import write
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.depth_bounds import bounds_of_views
from dofbench.datasets.synthesis.depth_record import make_depth
from dofbench.datasets.synthesis.masked_views import write_view_masks
from dofbench.datasets.synthesis.method_points import choose_points
from dofbench.datasets.synthesis.readme import photographs_readme
from dofbench.datasets.synthesis.scene_source import (
    check_source,
    encoded,
    image_digests,
    largest_image,
    source_record,
)
from dofbench.datasets.synthesis.work import WORK, Identity, finish, prepare
from dofbench.runtime.view_threads import over_views, views_at_once
from dofbench.scenes.depth.given import require_depth, with_folder_depth
from dofbench.scenes.depth.source import SourceId
from dofbench.scenes.named import ResolvedScene
from dofbench.scenes.reconstruction.posed_points import program
from dofbench.scenes.scene import Scene, SceneView


def make_of_photographs(
    found: ResolvedScene,
    scene: Scene,
    settings: MakeDataset,
    progress: Progress,
    *,
    expected: SourceRecord | None = None,
) -> Path:
    """Make the dataset, or what is missing of it; returns its folder.

    expected: the scene that is required. Raises InputError for an option about blur, and the errors of `make`.
    """
    settings.check_unblurred(scene.name)
    scene = _with_depth(scene, settings)
    at_once = views_at_once(largest_image(scene))
    source = source_record(scene, found, with_depth=True, at_once=at_once)
    if expected is not None:
        check_source(source, expected, scene.root)
    recipe = settings.photograph_recipe()
    identity = Identity(
        rest=sha256_text(
            canonical_json(
                {
                    "settings": recipe,
                    "photographs": {view.name: view.photograph for view in scene.views},
                    "dofbench": __version__,
                    **({} if settings.points == "scene" else {"points": program(), "bounds": "points"}),
                    "source": source.model_dump(mode="json", include={"scene", "layout", "geometry"}),
                    **({"exif": exif} if (exif := _exif_data(scene)) else {}),
                }
            )
        ),
        images=image_digests(source),
        own_depth=True,
    )
    out = settings.out or Path("data") / scene.name
    with only_writer(out):
        if prepare(out, identity) == "complete":
            progress.finished(out, "up to date")
            return out
        _photographs(scene, out, progress, at_once)
        write_view_masks(scene, out, lambda _, mask: mask, at_once)
        depth, disparity_range = _depth(scene, settings, out, progress, at_once)
        points, points_record = choose_points(scene, settings.points, out, out / WORK / "points", progress)
        scene = replace(scene, points=points)
        measured = {record.view for record in depth.views} if depth is not None else set()
        notes = write.geometry(out, scene, bounds_of_views(scene, out, settings.points, measured, at_once), measured)
        write.unknown_lens_file(out, scene, disparity_range)
        write.exif_file(out, scene)
        write.photographs_sheet(out, scene, measured, disparity_range, at_once)
        bounded = (out / layout.POSES_BOUNDS).is_file()
        write_text(
            out / write.README,
            photographs_readme(scene, settings, source, depth, points_record, notes, bounded=bounded),
        )
        write.manifest(
            out,
            name=scene.name,
            settings=settings,
            recipe=recipe,
            source=source,
            depth=depth,
            points=points_record,
            identity=identity.digest,
            offset=scene.offset,
            at_once=at_once,
        )
        finish(out)
    progress.finished(out, f"{len(scene.views)} views of unknown lens")
    return out


def _with_depth(scene: Scene, settings: MakeDataset) -> Scene:
    kind, place = settings.depth_source
    if kind == "folder" and place is not None:
        return with_folder_depth(scene, place, settings.depth_unit)
    if kind == "given":
        require_depth(scene)
    return scene


def _exif_data(scene: Scene) -> dict[str, dict[str, Any]]:
    return {view.name: view.exif.as_data() for view in scene.views if view.exif is not None}


def _photographs(scene: Scene, out: Path, progress: Progress, at_once: int) -> None:
    def write_one(view: SceneView) -> None:
        places = [layout.shallow_path, *([layout.sharp_path] if view.photograph == "all-in-focus" else [])]
        missing = [path for place in places if not (path := place(out, view.name)).is_file()]
        if missing:
            image = encoded(view)
            for path in missing:
                write_png(path, image)

    with progress.stage("photographs", len(scene.views)) as advance:
        for done, _ in enumerate(over_views(write_one, scene.views, at_once), 1):
            advance(done)


def _depth(
    scene: Scene, settings: MakeDataset, out: Path, progress: Progress, at_once: int
) -> tuple[DepthRecord | None, DisparityRange | None]:
    """Depth of the views that have it, and the range of their disparity; (None, None) without any."""
    indices = [index for index, view in enumerate(scene.views) if view.depth is not None]
    if not indices:
        return None, None
    points = None if scene.points is None else scene.points.seen_by(indices)
    measured = replace(scene, views=tuple(scene.views[index] for index in indices), points=points)
    source: SourceId = "folder" if settings.depth_source[0] == "folder" else "given"
    return make_depth(measured, source, None, settings, out, progress, at_once=at_once)
