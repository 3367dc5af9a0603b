"""reconstruct.json: what was done, with what, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from dofbench import __version__
from dofbench.scenes.reconstruction.focal_length import CameraGroup
from dofbench.scenes.reconstruction.photograph_source import Source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.registration_report import ViewReport, median_points
from dofbench.scenes.undistort import Intrinsics

SCHEMA, VERSION = "dofbench-reconstruction", 1
REPEATS = (
    "The same photographs, settings, seed and versions on the same machine give the same cameras, poses and points "
    "to the bit, whatever the number of threads; `seconds` differ. On another machine they differ in the last digits, "
    "and what depends on them."
)


def record(
    settings: Reconstruct,
    source: Source,
    digests: Mapping[str, str],
    identity: str,
    groups: Sequence[CameraGroup],
    views: Sequence[ViewReport],
    model: Any,
    intrinsics: Mapping[str, Intrinsics],
    *,
    matching: Mapping[str, Any],
    mapping: Mapping[str, Any],
    seconds: Mapping[str, float],
) -> dict[str, Any]:
    """The content, plain data. digests: the source's. model: a pycolmap.Reconstruction. intrinsics: of each photograph
    with a pose, found."""
    from dofbench.scenes.colmap_binding import pycolmap

    return {
        "schema": SCHEMA,
        "version": VERSION,
        "dofbench": __version__,
        "pycolmap": pycolmap.__version__,
        "command": settings.command(),
        "settings": settings.recipe(),
        "seed": settings.seed,
        "repeats": REPEATS,
        "identity": identity,
        "source": {"kind": source.kind, "name": source.name, "sha256": dict(digests)},
        "cameras": [_camera(group, intrinsics) for group in groups],
        "matching": dict(matching),
        "mapping": dict(mapping),
        "points": model.num_points3D(),
        "mean_reprojection_error": round(model.compute_mean_reprojection_error(), 4),
        "median_points_seen": median_points(views),
        "mean_track_length": round(model.compute_mean_track_length(), 3),
        "views": [asdict(view) for view in views],
        "seconds": dict(seconds),
        **({"notes": list(source.notes)} if source.notes else {}),
    }


def _camera(group: CameraGroup, intrinsics: Mapping[str, Intrinsics]) -> dict[str, Any]:
    """A camera before and after: what EXIF said of its focal length, and what was found."""
    content: dict[str, Any] = {
        "views": list(group.names),
        "width": group.width,
        "height": group.height,
        "focal_prior": round(group.focal, 3),
        "told_by": group.told_by,
    }
    found = next((intrinsics[name] for name in group.names if name in intrinsics), None)
    if found is not None:
        content |= {
            "focal": [found.fx, found.fy],
            "principal_point": [found.cx, found.cy],
            "distortion": list(found.distortion),
        }
    return content
