"""Notes on what a scene has and isn't used: images without a pose, poses without an image, files of another format."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from dofbench.core.contracts import PointCloud
from dofbench.scenes.readers.folders import MatchedFiles, image_files, is_scaled, listed


def without_pose(folder: Path, used: Iterable[Path], poses: object) -> str:
    """The image files of a folder that `poses` (a file or model) has no pose for; empty where it has all."""
    files, known = image_files(folder), set(used)
    unused = [path.relative_to(folder).as_posix() for path in files if path not in known]
    if not unused:
        return ""
    return (
        f"{len(files)} images in {folder.name}, {len(files) - len(unused)} with a pose in {poses}: {_not_used(unused)}"
    )


def skipped(names: Sequence[str], matched: MatchedFiles, poses: object) -> str:
    """The poses that have no image file; empty where all have one."""
    missing = [name for name, file in zip(names, matched.files, strict=True) if file is None]
    return (
        f"{len(names)} poses in {poses}, {len(missing)} without an image, skipped: {listed(missing)}" if missing else ""
    )


def fewer_points(points: PointCloud | None, kept: PointCloud | None) -> str:
    """How many points no view is left of; empty where all are kept."""
    if points is None or kept is None or len(kept) == len(points):
        return ""
    return f"{len(points)} points, {len(points) - len(kept)} that no remaining view saw: skipped"


def other_format(matched: MatchedFiles, folder: Path, poses: object) -> str:
    """How many images have another suffix than their names in `poses`; empty where none has, and for a folder of scaled
    copies (images_8), which often have."""
    if not matched.other_format or is_scaled(folder):
        return ""
    return f"{matched.other_format} of {len(matched.files)} images have another suffix than their names in {poses}"


def _not_used(names: Sequence[str]) -> str:
    return f"{len(names)} not used ({listed(names)})"
