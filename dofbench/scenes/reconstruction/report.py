"""Report of a reconstruction: per photograph, in words, and as reconstruct.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dofbench import __version__
from dofbench.scenes.reconstruction.features import CameraGroup, FeatureCount
from dofbench.scenes.reconstruction.matching import Pair
from dofbench.scenes.reconstruction.photograph_list import Prepared
from dofbench.scenes.reconstruction.photograph_source import Source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.undistort import Intrinsics

# Below so many features a photograph can hardly be placed: COLMAP wants 30 points seen, and most features match none.
FEW = 150
# COLMAP itself takes no pose from fewer points; the lenient attempt does.
_WEAK = 30
# Of the typical sharpness of the set, below which a photograph is called blurred.
_BLURRED = 0.25
SCHEMA, VERSION = "dofbench-reconstruction", 1
REPEATS = (
    "The same photographs, settings, seed and versions on the same machine give the same cameras, poses and points "
    "to the bit, whatever the number of threads; `seconds` differ. On another machine they differ in the last digits, "
    "and what depends on them."
)


@dataclass(frozen=True)
class ViewReport:
    """One photograph. partners: photographs with verified matches. matches: the most with one of them.

    points: that it sees. error: mean reprojection error, pixels of the shrunk photograph; None without a pose. why,
    advice: of one without a pose, else empty.
    """

    name: str
    registered: bool
    features: int
    coarse_features: int
    sharpness: float
    partners: int
    matches: int
    points: int
    error: float | None
    why: str = ""
    advice: str = ""


def view_reports(
    photographs: Sequence[Prepared],
    counts: Mapping[str, FeatureCount],
    verified: Mapping[Pair, int],
    model: Any | None,
    others: Sequence[Sequence[str]],
) -> list[ViewReport]:
    """A report for every photograph. model: a pycolmap.Reconstruction, None without one. others: views of parts that
    are connected in themselves but not to it."""
    seen = {} if model is None else _seen(model)
    usual = float(np.median([photograph.sharpness for photograph in photographs]))
    reports = []
    for index, photograph in enumerate(photographs):
        mine = [number for pair, number in verified.items() if index in pair]
        count = counts[photograph.name]
        points, error = seen.get(photograph.file_name, (0, None))
        registered = photograph.file_name in seen
        reason = ("", "") if registered else _reason(photograph, count, mine, others, usual)
        matches = count.features, count.coarse, round(photograph.sharpness, 2), len(mine), max(mine, default=0)
        reports.append(ViewReport(photograph.name, registered, *matches, points, error, *reason))
    return reports


def remarks(reports: Sequence[ViewReport], video: bool) -> list[str]:
    """Lines for the user: one for each photograph without a pose, at most ten, and one about the rest."""
    missing = [report for report in reports if not report.registered]
    lines = [f"{report.name}: no pose: {report.why}; {report.advice}" for report in missing[:10]]
    if len(missing) > len(lines):
        lines.append(f"and {len(missing) - len(lines)} more without a pose; reconstruct.json has them all")
    if len(missing) > len(reports) / 2:
        overlap = (
            "a slower walk, or more --frames, gives frames that overlap more."
            if video
            else "neighbours should overlap by two thirds, taken from different places, not from one by turning."
        )
        lines.append(f"More than half have no pose: {overlap}")
    seen = median_points(reports)
    if seen is not None and seen < _WEAK:
        lines.append(
            f"The poses are doubtful: the typical photograph sees {seen:g} points; fewer than {_WEAK} gave "
            "focal lengths wrong by a fifth to a half. Take more photographs, nearer to each other."
        )
    return lines


def median_points(reports: Sequence[ViewReport]) -> float | None:
    """Median number of points in photographs with a pose; None without any."""
    seen = [report.points for report in reports if report.registered]
    return float(np.median(seen)) if seen else None


def _reason(
    photograph: Prepared, count: FeatureCount, matches: Sequence[int], others: Sequence[Sequence[str]], usual: float
) -> tuple[str, str]:
    """Why a photograph has no pose, and what to do about it."""
    if count.features < FEW:
        what = "blurred all over" if photograph.sharpness < _BLURRED * usual else "dark, plain or blurred"
        advice = "leave it out, or take it with something sharp and textured in it"
        return f"{count.features} features, it is {what}", advice
    if not matches:
        advice = "take photographs between it and the others, overlapping by two thirds"
        return "no other photograph shows enough of the same", advice
    for part in others:
        if photograph.name in part:
            why = f"it hangs together with {len(part) - 1} others, but not with the rest"
            return why, "take photographs between the two parts, or reconstruct this part by itself"
    why = f"at most {max(matches)} matches with one of {len(matches)} photographs, too few points in common with those "
    advice = "take more photographs near it, or try --mapping global, or --cameras each if the lens was zoomed"
    return f"{why}that have poses", advice


def _seen(model: Any) -> dict[str, tuple[int, float | None]]:
    """Number of points that a photograph sees, and their mean reprojection error (pixels), by file name."""
    found = {}
    for key in model.reg_image_ids():
        image = model.images[key]
        observed = [point for point in image.points2D if point.has_point3D()]
        pixels = [(image.project_point(model.points3D[point.point3D_id].xyz), point.xy) for point in observed]
        errors = [float(np.linalg.norm(np.asarray(pixel) - xy)) for pixel, xy in pixels if pixel is not None]
        found[image.name] = (len(observed), round(float(np.mean(errors)), 3) if errors else None)
    return found


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
    """Content of reconstruct.json. digests: the source's. model: a pycolmap.Reconstruction. intrinsics: found, of each
    photograph with a pose."""
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
    """A camera: its focal length by EXIF, and what was found."""
    size = {"views": list(group.names), "width": group.width, "height": group.height}
    prior = {"focal_prior": round(group.focal, 3), "told_by": group.told_by}
    lens = next((intrinsics[name] for name in group.names if name in intrinsics), None)
    if lens is None:
        return {**size, **prior}
    centre, distortion = [lens.cx, lens.cy], list(lens.distortion)
    return {**size, **prior, "focal": [lens.fx, lens.fy], "principal_point": centre, "distortion": distortion}
