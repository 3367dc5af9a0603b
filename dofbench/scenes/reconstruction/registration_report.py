"""What came of every photograph, in words that help: what registered, what didn't and why, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dofbench.scenes.reconstruction.features import FeatureCount
from dofbench.scenes.reconstruction.pairs import Pair
from dofbench.scenes.reconstruction.photograph_list import Prepared

# Below so many features a photograph can hardly be placed: COLMAP wants 30 points seen, and most features match none.
FEW = 150
# COLMAP itself takes no pose from fewer points; the lenient attempt does.
_WEAK = 30
# Of the typical sharpness of the set, below which a photograph is called blurred.
_BLURRED = 0.25


@dataclass(frozen=True)
class ViewReport:
    """One photograph. partners: photographs with which matches were verified. matches: the most with one of them.

    points: that it sees. error: mean reprojection error in pixels of the photograph as it was shrunk; None where it
    has no pose. why, advice: of one without a pose, else empty.
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
    """A report for every photograph. model: a pycolmap.Reconstruction, None where nothing was found. others: parts that
    hang together apart from it, by view."""
    seen = {} if model is None else _seen(model)
    usual = float(np.median([photograph.sharpness for photograph in photographs]))
    reports = []
    for index, photograph in enumerate(photographs):
        mine = [number for pair, number in verified.items() if index in pair]
        count = counts[photograph.name]
        points, error = seen.get(photograph.file_name, (0, None))
        registered = photograph.file_name in seen
        why, advice = ("", "") if registered else _reason(photograph, count, mine, others, usual)
        reports.append(
            ViewReport(
                photograph.name,
                registered,
                count.features,
                count.coarse,
                round(photograph.sharpness, 2),
                len(mine),
                max(mine, default=0),
                points,
                error,
                why,
                advice,
            )
        )
    return reports


def remarks(reports: Sequence[ViewReport], video: bool) -> list[str]:
    """What to tell the user: a line for each photograph without a pose, at most ten, and one about the rest."""
    missing = [report for report in reports if not report.registered]
    lines = [f"{report.name}: no pose: {report.why}; {report.advice}" for report in missing[:10]]
    if len(missing) > len(lines):
        lines.append(f"and {len(missing) - len(lines)} more without a pose; reconstruct.json has them all")
    if len(missing) > len(reports) / 2:
        lines.append(
            "More than half have no pose: "
            + (
                "a slower walk, or more --frames, gives frames that overlap more."
                if video
                else "neighbours should overlap by two thirds, taken from different places, not from one by turning."
            )
        )
    seen = median_points(reports)
    if seen is not None and seen < _WEAK:
        lines.append(
            f"The poses are doubtful: the typical photograph sees {seen:g} points; fewer than {_WEAK} gave "
            "focal lengths wrong by a fifth to a half. Take more photographs, nearer to each other."
        )
    return lines


def median_points(reports: Sequence[ViewReport]) -> float | None:
    """Points that the typical photograph with a pose sees; None without any."""
    seen = [report.points for report in reports if report.registered]
    return float(np.median(seen)) if seen else None


def _reason(
    photograph: Prepared, count: FeatureCount, matches: Sequence[int], others: Sequence[Sequence[str]], usual: float
) -> tuple[str, str]:
    blurred = photograph.sharpness < _BLURRED * usual
    if count.features < FEW:
        what = "blurred all over" if blurred else "dark, plain or blurred"
        return (
            f"{count.features} features, it is {what}",
            "leave it out, or take it with something sharp and textured in it",
        )
    if not matches:
        return (
            "no other photograph shows enough of the same",
            "take photographs between it and the others, overlapping by two thirds",
        )
    for part in others:
        if photograph.name in part:
            return (
                f"it hangs together with {len(part) - 1} others, but not with the rest",
                "take photographs between the two parts, or reconstruct this part by itself",
            )
    return (
        f"at most {max(matches)} matches with one of {len(matches)} photographs, too few points in common with "
        "those that have poses",
        "take more photographs near it, or try --mapping global, or --cameras each if the lens was zoomed",
    )


def _seen(model: Any) -> dict[str, tuple[int, float | None]]:
    """By file name: the points that a photograph sees, and their mean reprojection error, pixels."""
    found = {}
    for key in model.reg_image_ids():
        image = model.images[key]
        observed = [point for point in image.points2D if point.has_point3D()]
        errors = []
        for point in observed:
            pixel = image.project_point(model.points3D[point.point3D_id].xyz)
            if pixel is not None:
                errors.append(float(np.linalg.norm(np.asarray(pixel) - point.xy)))
        found[image.name] = (len(observed), round(float(np.mean(errors)), 3) if errors else None)
    return found
