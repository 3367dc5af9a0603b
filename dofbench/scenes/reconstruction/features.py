"""Features of every photograph, from all scales that it has: what is out of focus has none at the fine ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.scenes.reconstruction.focal_length import CameraGroup
from dofbench.scenes.reconstruction.interruptible import Wait
from dofbench.scenes.reconstruction.photograph_list import Prepared

FIRST_OCTAVE = -1
# Fewest pixels on the shorter side of the coarsest octave: below that a feature covers the whole picture.
_COARSEST = 16
# Scale in pixels from which a feature is called coarse: it survives a circle of confusion of that radius.
COARSE = 4.0


@dataclass(frozen=True)
class FeatureCount:
    """Features of a photograph. coarse: those of a scale above `COARSE` pixels."""

    features: int
    coarse: int


def octaves(width: int, height: int) -> int:
    """Octaves of a scale space that begins at twice the size (first octave -1), for pictures of this size."""
    return max(4, math.floor(math.log2(max(1.0, min(width, height) / _COARSEST))) - FIRST_OCTAVE + 1)


def register_images(
    database: Path, folder: Path, photographs: Sequence[Prepared], groups: Sequence[CameraGroup], model: str
) -> None:
    """Write cameras and photographs into a new database, in order: ids count from 1 in the order of `photographs`.

    Where the poses are known, every photograph has its own camera, held as it is.
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
            opened.write_camera(_known_camera(photograph)) if photograph.camera is not None else 0
            for photograph in photographs
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
    wait: Wait,
    advance: Callable[[int], None],
    masks: Path | None = None,
) -> dict[str, FeatureCount]:
    """Features of every photograph, by name; those that the database has are kept.

    most: features a photograph, the coarsest before the others. masks: folder of masks, FILE_NAME.png for those
    photographs that have one: no feature is taken where they are black. advance: called with the number of photographs
    done.
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
    for start in range(0, len(photographs), threads):
        names = [photograph.file_name for photograph in photographs[start : start + threads]]
        extracted = partial(
            pycolmap.extract_features,
            database,
            folder,
            image_names=names,
            reader_options=reader,
            extraction_options=options,
        )
        wait(extracted)
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
    """(N,) scale in pixels of keypoints as COLMAP keeps them: x y scale orientation, or x y and a 2x2 matrix."""
    if keypoints.shape[1] < 6:
        return keypoints[:, 2]
    return np.sqrt(np.abs(keypoints[:, 2] * keypoints[:, 5] - keypoints[:, 3] * keypoints[:, 4]))


def read(database: Path, photographs: Sequence[Prepared]) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Of every photograph: its id in the database, its keypoints (N, 4 or 6) and descriptors (N, 128) uint8."""
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


def _known_camera(photograph: Prepared) -> Any:
    from dofbench.scenes.colmap_binding import pycolmap

    known = photograph.camera
    assert known is not None
    camera = pycolmap.Camera(
        model="PINHOLE",
        width=photograph.width,
        height=photograph.height,
        params=list(known.parameters),
    )
    camera.has_prior_focal_length = True
    return camera
