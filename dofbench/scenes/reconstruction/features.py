"""Group photographs by camera and extract features at all scales: defocused areas have coarse ones only."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dofbench.core.image_files.exif import Exif
from dofbench.scenes.reconstruction.kept_steps import wait
from dofbench.scenes.reconstruction.photograph_list import Prepared

# The diagonal of 36 x 24 mm: what "35 mm equivalent" refers to (CIPA DCG-001).
_FULL_FRAME = math.hypot(36.0, 24.0)
# Without EXIF: the longer side times this, COLMAP's guess, a field of view of 45 degrees.
UNKNOWN_FACTOR = 1.2
FIRST_OCTAVE = -1
# Fewest pixels on the shorter side of the coarsest octave: below that a feature covers the whole picture.
_COARSEST = 16
# Scale in pixels from which a feature is called coarse: it survives a circle of confusion of that radius.
COARSE = 4.0


@dataclass(frozen=True)
class CameraGroup:
    """Photographs of one camera. focal: initial value, pixels. known: whether `told_by`, EXIF or poses, states it."""

    names: tuple[str, ...]
    width: int
    height: int
    focal: float
    known: bool
    told_by: str


def focal_length(exif: Exif | None, width: int, height: int, sensor_width: float | None) -> tuple[float, str] | None:
    """Focal length in pixels and its source, from the mm and the sensor's longer side (mm), else from the 35 mm
    equivalent by the image's diagonal; None where neither is known."""
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


@dataclass(frozen=True)
class FeatureCount:
    """Features of a photograph. coarse: those of a scale above `COARSE` pixels."""

    features: int
    coarse: int


def octaves(width: int, height: int) -> int:
    """Octaves of a scale space that begins at twice the size (first octave -1), for images of this size."""
    return max(4, math.floor(math.log2(max(1.0, min(width, height) / _COARSEST))) - FIRST_OCTAVE + 1)


def register_images(
    database: Path, folder: Path, photographs: Sequence[Prepared], groups: Sequence[CameraGroup], model: str
) -> None:
    """Write cameras and photographs into a new database; ids count from 1 in the order of `photographs`.

    A photograph with a known pose has its own camera, held fixed.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    group_of = {name: index for index, group in enumerate(groups) for name in group.names}
    with pycolmap.Database.open(database) as opened:
        if opened.num_images() == len(photographs):
            return
        for table in ("images", "frames", "rigs", "cameras"):
            getattr(opened, f"clear_{table}")()
        ids = [opened.write_camera(_camera(group, model)) for group in groups]
        own = [
            0 if photograph.camera is None else opened.write_camera(_known(photograph)) for photograph in photographs
        ]
    for index, photograph in enumerate(photographs):
        options = pycolmap.ImageReaderOptions()
        options.existing_camera_id = own[index] or ids[group_of[photograph.name]]
        pycolmap.import_images(database, folder, image_names=[photograph.file_name], options=options)


def extract(
    database: Path,
    folder: Path,
    photographs: Sequence[Prepared],
    *,
    most: int,
    threads: int,
    advance: Callable[[int], None],
    masks: Path | None = None,
) -> dict[str, FeatureCount]:
    """Extract features of every photograph, by name; those in the database are kept.

    most: features a photograph, the coarsest first. masks: folder of masks, FILE_NAME.png: no feature is taken where
    they are black. advance: called with the number of photographs done.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    reader = pycolmap.ImageReaderOptions()
    if masks is not None and masks.is_dir():
        reader.mask_path = str(masks)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = threads
    options.sift.first_octave = FIRST_OCTAVE
    options.sift.num_octaves = max(octaves(photograph.width, photograph.height) for photograph in photographs)
    options.sift.max_num_features = most
    extracted = partial(pycolmap.extract_features, database, folder, reader_options=reader, extraction_options=options)
    for start in range(0, len(photographs), threads):
        names = [photograph.file_name for photograph in photographs[start : start + threads]]
        wait(partial(extracted, image_names=names))
        advance(min(len(photographs), start + threads))
    return counts(database, photographs)


def counts(database: Path, photographs: Sequence[Prepared]) -> dict[str, FeatureCount]:
    """Features of every photograph in the database, by name."""
    found = {}
    for photograph, (_, keypoints, _) in zip(photographs, read(database, photographs), strict=True):
        scale = scales(keypoints)
        found[photograph.name] = FeatureCount(len(scale), int((scale > COARSE).sum()))
    return found


def scales(keypoints: np.ndarray) -> np.ndarray:
    """(N,) scale in pixels of COLMAP's keypoints: x y scale orientation, or x y and a 2x2 matrix."""
    if keypoints.shape[1] < 6:
        return keypoints[:, 2]
    return np.sqrt(np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4]))


def read(database: Path, photographs: Sequence[Prepared]) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Id in the database, keypoints (N, 4 or 6) and descriptors (N, 128) uint8 of every photograph."""
    from dofbench.scenes.colmap_binding import pycolmap

    found = []
    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        for photograph in photographs:
            key = ids[photograph.file_name]
            keypoints = np.asarray(opened.read_keypoints(key), dtype=np.float32)
            descriptors = np.asarray(opened.read_descriptors(key).data, dtype=np.uint8)
            if not keypoints.size:
                keypoints, descriptors = np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)
            found.append((key, keypoints, descriptors))
    return found


def _camera(group: CameraGroup, model: str) -> Any:
    from dofbench.scenes.colmap_binding import pycolmap

    camera = pycolmap.Camera.create_from_model_name(1, model, group.focal, group.width, group.height)
    camera.has_prior_focal_length = group.known
    return camera


def _known(photograph: Prepared) -> Any:
    from dofbench.scenes.colmap_binding import pycolmap

    assert photograph.camera is not None
    width, height, params = photograph.width, photograph.height, list(photograph.camera.parameters)
    camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params)
    camera.has_prior_focal_length = True
    return camera
