"""Triangulate sparse points from the 8-bit images by SIFT and matching, with true, fixed poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.cameras import Camera

# Limits in pixels and degrees; COLMAP's defaults are larger, for images ten times as wide.
_MATCH_ERROR = 1.0
_REPROJECTION_ERROR = 1.0
_ANGLE_ERROR = 0.5


def triangulate(cameras: Sequence[Camera], names: Sequence[str], images: Path, work: Path, output: Path) -> Any:
    """Write a COLMAP model with points and tracks to `output`; returns it (pycolmap.Reconstruction).

    names: file names in the folder `images`, one per camera; all cameras share their intrinsics. work: a folder for the
    database. One thread and fixed seeds: the same images give the same points. Keypoints without a point are excluded.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    pycolmap.set_random_seed(0)
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    first = cameras[0]
    database = work / "database.db"
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    reader.camera_params = ",".join(repr(value) for value in first.parameters)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = 1
    pycolmap.extract_features(
        database,
        images,
        image_names=list(names),
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.max_error = _MATCH_ERROR
    verification.ransac.random_seed = 0
    verification.detect_watermark = False
    pycolmap.match_exhaustive(
        database, matching_options=matching, verification_options=verification, device=pycolmap.Device.cpu
    )
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, 0
    points = options.triangulation
    points.random_seed = 0
    points.create_max_angle_error = points.continue_max_angle_error = _ANGLE_ERROR
    points.merge_max_reproj_error = points.complete_max_reproj_error = _REPROJECTION_ERROR
    options.mapper.filter_max_reproj_error = _REPROJECTION_ERROR
    raw = work / "triangulated"
    raw.mkdir()
    found = pycolmap.triangulate_points(_posed(cameras, names, None), database, images, raw, options=options)
    model = _posed(cameras, names, found)
    output.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(output))
    return model


def depth_errors(cameras: Sequence[Camera], model: Any, depths: Sequence[np.ndarray]) -> np.ndarray:
    """Relative depth error of every observation, |z of the point / depth map at its keypoint - 1|; image ids count from
    1 in the order of `cameras`."""
    errors = []
    for index, camera in enumerate(cameras):
        seen = [point for point in model.image(index + 1).points2D if point.has_point3D()]
        # A view that sees no point gives an array without a shape of its own.
        _, z = camera.project(np.array([model.point3D(point.point3D_id).xyz for point in seen]).reshape(-1, 3))
        column, row = np.floor(np.array([point.xy for point in seen]).reshape(-1, 2)).astype(int).T
        errors.append(np.abs(z / depths[index][row, column] - 1))
    return np.concatenate(errors)


def _posed(cameras: Sequence[Camera], names: Sequence[str], found: Any) -> Any:
    """A model with these poses, and the points of the model `found`, if any; ids count from 1 in order."""
    from dofbench.scenes.colmap_binding import pycolmap

    first = cameras[0]
    model = pycolmap.Reconstruction()
    width, height, parameters = first.width, first.height, list(first.parameters)
    camera = pycolmap.Camera(camera_id=1, model="PINHOLE", width=width, height=height, params=parameters)
    model.add_camera_with_trivial_rig(camera)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for number, (view, name) in enumerate(zip(cameras, names, strict=True), start=1):
        image = pycolmap.Image(image_id=number, name=name, camera_id=1)
        if found is not None:
            used = [point for point in found.find_image_with_name(name).points2D if point.has_point3D()]
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(point.xy) for point in used])
            for place, point in enumerate(used):
                tracks.setdefault(point.point3D_id, []).append((number, place))
        pose = pycolmap.Rigid3d(view.world_to_camera[:3])
        model.add_image_with_trivial_frame(image, pose)
    for identity in sorted(tracks):
        point = found.point3D(identity)
        track = pycolmap.Track([pycolmap.TrackElement(image, place) for image, place in tracks[identity]])
        model.add_point3D(point.xyz, track, point.color)
    model.update_point_3d_errors()
    return model
