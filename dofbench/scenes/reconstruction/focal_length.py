"""Which photographs share a camera, and what EXIF says of its focal length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dofbench.core.image_files.exif import Exif
from dofbench.scenes.reconstruction.photograph_list import Prepared

# The diagonal of 36 x 24 mm: what "35 mm equivalent" refers to (CIPA DCG-001).
_FULL_FRAME = math.hypot(36.0, 24.0)
# Without EXIF: the longer side times this, COLMAP's guess, a field of view of 45 degrees.
UNKNOWN_FACTOR = 1.2


@dataclass(frozen=True)
class CameraGroup:
    """Photographs of one camera. focal: pixels, where the optimisation starts. known: whether EXIF or poses say it."""

    names: tuple[str, ...]
    width: int
    height: int
    focal: float
    known: bool
    told_by: str


def focal_length(exif: Exif | None, width: int, height: int, sensor_width: float | None) -> tuple[float, str] | None:
    """Focal length in pixels and what told it; None where neither EXIF nor the sensor does.

    From the 35 mm equivalent by the image's diagonal; else from the mm and the sensor's longer side, mm.
    """
    if exif is None:
        return None
    if exif.focal_length is not None and sensor_width is not None:
        return exif.focal_length / sensor_width * max(width, height), "focal length and --sensor-width"
    if exif.focal_length_35mm is not None:
        return exif.focal_length_35mm / _FULL_FRAME * math.hypot(width, height), "35 mm equivalent"
    return None


def group_by_camera(
    photographs: Sequence[Prepared], cameras: Literal["auto", "shared", "each"], sensor_width: float | None
) -> list[CameraGroup]:
    """The cameras, in order of their first photograph. auto: one for equal size, body, lens and focal length."""
    groups: dict[Any, list[Prepared]] = {}
    for photograph in photographs:
        key: Any = (photograph.width, photograph.height)
        exif = photograph.exif or Exif()
        if cameras == "each":
            key = photograph.name
        elif cameras == "auto":
            key = (*key, exif.camera, exif.lens, exif.focal_length, exif.focal_length_35mm)
        groups.setdefault(key, []).append(photograph)
    return [_group(members, sensor_width) for members in groups.values()]


def _group(members: Sequence[Prepared], sensor_width: float | None) -> CameraGroup:
    first = members[0]
    told = focal_length(first.exif, first.width, first.height, sensor_width)
    focal, by = told or (UNKNOWN_FACTOR * max(first.width, first.height), "nothing: a usual field of view is assumed")
    return CameraGroup(tuple(member.name for member in members), first.width, first.height, focal, told is not None, by)
