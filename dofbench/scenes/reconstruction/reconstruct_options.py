"""Options of `reconstruct`."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from pydantic import Field

from dofbench.core.options import flag, options
from dofbench.scenes.scene import Alpha

Matching = Literal["auto", "exhaustive", "sequential", "retrieval"]
Mapping = Literal["incremental", "global"]
CameraModel = Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]


@options()
class Reconstruct:
    """Find the camera poses and sparse points of photographs or a video: the result is a scene for make-dataset.

    Where the source has poses already but no points, the poses are kept and the points triangulated.
    """

    source: Annotated[Path, tyro.conf.Positional]
    """A folder of photographs, a video file, or a scene with poses."""

    out: Path
    """Folder to write the scene to: images without distortion, a COLMAP model, exif.json, reconstruct.json."""

    poses: Literal["keep", "ignore"] = "keep"
    """Poses that the source has: keep them and triangulate points, or find them anew."""

    images: str | None = None
    """Folder of photographs within the source; without it, the one with the largest photographs."""

    size: Annotated[int, Field(ge=64)] = 1600
    """Longer side that photographs are shrunk to, pixels; smaller ones stay as they are."""

    frames: Annotated[int, Field(ge=3)] = 60
    """Frames to take from a video: the sharpest of each of so many windows of equal length."""

    matching: Matching = "auto"
    """Which photographs are compared: all pairs, neighbours in order (and look-alikes), or look-alikes; auto goes by
    their number."""

    mapping: Mapping = "incremental"
    """Poses one photograph after the other, or all at once (GLOMAP)."""

    cameras: Literal["auto", "shared", "each"] = "auto"
    """One camera for the photographs of equal size, body and focal length; for all of equal size; or one for each."""

    camera_model: CameraModel = "SIMPLE_RADIAL"
    """COLMAP's model of a camera with its distortion."""

    alpha_channel: Alpha | None = None
    """What an alpha channel means: mask, no features in transparent pixels; or background, composited over black.
    Without it: mask, with a note."""

    sensor_width: Annotated[float, Field(ge=1, le=200)] | None = None
    """Longer side of the sensor, mm (36 for full frame): where EXIF has no 35 mm equivalent, it makes mm to pixels."""

    features: Annotated[int, Field(ge=100)] = 8192
    """Features of a photograph, at most; the coarsest ones are kept."""

    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random choices in matching and mapping."""

    def recipe(self) -> dict[str, Any]:
        """Options that decide the result, as plain data: all but paths."""
        skipped = {"source", "out", *(("alpha_channel",) if self.alpha_channel is None else ())}
        return {name: value for name, value in asdict(self).items() if name not in skipped}

    def command(self) -> str:
        """The command line of these settings."""
        defaults = {name: field.default for name, field in self.__dataclass_fields__.items()}
        words = ["dofbench", "reconstruct", str(self.source), "--out", str(self.out)]
        for name, value in self.recipe().items():
            if value != defaults[name]:
                words += [flag(name), str(value)]
        return shlex.join(words)
