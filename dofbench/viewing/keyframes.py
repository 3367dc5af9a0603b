"""Keyframes of a film in a JSON file: written by hand, by a program, or by the viewer.

{"schema_name": "dofbench.keyframes", "version": 1, "keyframes": [{"moment": 0, "camera_to_world": [[...], ...],
"focal_length": 1.2, "focus_disparity": 0.5, "half_opening": 0.01, "easing": "smooth"}, ...]}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.viewing import camera_paths
from dofbench.viewing.lens_track import Easing, Key, LensTrack, Track

SCHEMA: Literal["dofbench.keyframes"] = "dofbench.keyframes"
_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_RIGID = 1e-3  # largest error of a rotation that was written with a few digits


class Keyframe(BaseModel):
    """A camera and a lens at a moment of the film.

    moment: 0 to 1. camera_to_world: 4 x 4, rigid, scene units, axes x right, y down, z forward. focal_length: in image
    widths. focus_disparity: 1 / scene unit, 0 for infinity. half_opening: half the width of the lens's opening, scene
    units; 0 for all in focus. easing: of focus and aperture on the way from the keyframe before.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    moment: Annotated[float, Field(ge=0, le=1)]
    camera_to_world: tuple[_Row, _Row, _Row, _Row]
    focal_length: Annotated[FiniteFloat, Field(gt=0)]
    focus_disparity: FiniteFloat
    half_opening: Annotated[FiniteFloat, Field(ge=0)]
    easing: Easing = "smooth"

    @staticmethod
    def of(moment: float, camera: Camera, focus_disparity: float, half_opening: float) -> Keyframe:
        """The keyframe of a camera and its lens."""
        rows = [tuple(row) for row in camera.camera_to_world.tolist()]
        return Keyframe.model_validate(
            {
                "moment": moment,
                "camera_to_world": rows,
                "focal_length": camera.fx / camera.width,
                "focus_disparity": focus_disparity,
                "half_opening": half_opening,
            }
        )


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    schema_name: Literal["dofbench.keyframes"]
    version: Literal[1]
    keyframes: Annotated[list[Keyframe], Field(min_length=1)]


def write_keyframes(path: Path, keyframes: Sequence[Keyframe]) -> None:
    """Write the file, atomically."""
    data = {"schema_name": SCHEMA, "version": 1, "keyframes": [one.model_dump(mode="json") for one in keyframes]}
    write_json(path, data)


def read_keyframes(path: Path) -> list[Keyframe]:
    """The keyframes of a file, sorted by moment.

    Raises InputError for a missing or damaged file, a camera that isn't rigid, two keyframes of one moment, and
    keyframes that don't reach from moment 0 to 1.
    """
    try:
        found = _File.model_validate(read_json(path)).keyframes
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise InputError(path, f"{place}: {first['msg']}", "keyframes of version 1") from None
    found.sort(key=lambda keyframe: keyframe.moment)
    moments = [keyframe.moment for keyframe in found]
    if len(found) > 1 and (len(set(moments)) < len(found) or moments[0] != 0 or moments[-1] != 1):
        shown = ", ".join(f"{moment:g}" for moment in moments)
        raise InputError(path, f"moments {shown}", "different moments, from 0 to 1")
    for number, keyframe in enumerate(found, start=1):
        pose = np.array(keyframe.camera_to_world)
        turn = pose[:3, :3]
        off = max(np.abs(turn.T @ turn - np.eye(3)).max(), np.abs(pose[3] - (0, 0, 0, 1)).max())
        if off > _RIGID or np.linalg.det(turn) < 0:
            raise InputError(path, f"camera_to_world of keyframe {number} that isn't rigid", "a rotation and a place")
    return found


def film_of(keyframes: Sequence[Keyframe], like: Camera) -> tuple[camera_paths.Path, LensTrack]:
    """The camera path and the lens through the keyframes; image size and principal point are those of `like`."""
    cameras = []
    for keyframe in keyframes:
        pose = np.linalg.inv(np.array(keyframe.camera_to_world))
        fx = keyframe.focal_length * like.width
        cameras.append(replace(like, fx=fx, fy=fx * like.fy / like.fx, world_to_camera=pose))
    opening = Track([Key(one.moment, one.half_opening, one.easing) for one in keyframes])
    focus = Track([Key(one.moment, one.focus_disparity, one.easing) for one in keyframes])
    path = camera_paths.along(cameras, [one.moment for one in keyframes] if len(keyframes) > 1 else None)
    return path, LensTrack(opening, focus)
