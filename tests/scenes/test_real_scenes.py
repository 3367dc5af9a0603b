"""The readers on real photographs; skipped, with the reason, where they are absent."""

import json

import numpy as np
import pycolmap
import pytest
from tolerances import FLOAT64_VALUE, REPROJECTION_STRETCH, SAME_POSE, UNDISTORTED_PIXEL

from dofbench.scenes import load_scene
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.undistort import undistort_points, undistorted

LLFF = pytest.mark.parametrize(("name", "count", "points"), [("llff_fern", 20, 10091), ("llff_flower", 34, 23477)])
FOX = "nerf_fox"


def assert_rigid(scene):
    for view in scene.views:
        rotation = view.camera.world_to_camera[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=FLOAT64_VALUE)
        assert np.linalg.det(rotation) > 0


def inside(view, xyz):
    pixels, _ = view.camera.project(xyz)
    return ((pixels >= 0) & (pixels <= (view.camera.width, view.camera.height))).all(axis=1)


@LLFF
def test_llff_counts_sizes_and_split(real_data, name, count, points):
    scene = load_scene(real_data(name))
    assert (scene.layout, len(scene.views), len(scene.points)) == ("llff", count, points)
    assert scene.points.views is None, "the tracks of these models are dropped"
    assert {(view.camera.width, view.camera.height) for view in scene.views} == {(504, 378)}
    assert [index for index, view in enumerate(scene.views) if view.split == "test"] == list(range(0, count, 8))
    assert scene.views[0].image().shape == (378, 504, 3)
    assert load_scene(real_data(name), width=1008).views[0].source.parent.name == "images_4"
    assert_rigid(scene)


@LLFF
def test_llff_poses_are_those_of_the_colmap_model(real_data, name, count, points):
    llff, colmap = (load_scene(real_data(name), layout=layout, width=504) for layout in ("llff", "colmap"))
    for a, b in zip(llff.views, colmap.views, strict=True):
        assert a.name == b.name and a.source == b.source
        np.testing.assert_allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=SAME_POSE)
        assert a.camera.fx == pytest.approx(b.camera.fx, rel=FLOAT64_VALUE)
        assert (a.camera.cx, a.camera.cy) == (b.camera.cx, b.camera.cy)


@LLFF
def test_llff_points_lie_between_the_bounds_and_in_the_images(real_data, name, count, points):
    scene = load_scene(real_data(name))
    bounds = np.load(real_data(name) / "poses_bounds.npy")[:, 15:]
    for view, (near, far) in zip(scene.views, bounds, strict=True):
        _, depth = view.camera.project(scene.points.xyz)
        seen = inside(view, scene.points.xyz)
        assert seen.mean() > 0.5
        assert near < np.median(depth[seen]) < far


def test_fox(real_data):
    scene = load_scene(real_data(FOX))
    assert (scene.layout, len(scene.views), len(scene.points)) == ("nerfstudio", 50, 11914)
    assert_rigid(scene)
    view = scene.views[0]
    assert view.name == "0001" and view.image().shape == (960, 540, 3)
    assert [v.name for v in scene.views if v.split == "test"] == [v.name for v in scene.views[::8]]
    content = json.loads((real_data(FOX) / "transforms.json").read_text())
    # Undistortion enlarges a little, so that the border stays inside, and keeps pixels as square as they were.
    assert 1.0 < view.camera.fx / content["fl_x"] < 1.03
    assert view.camera.fx / view.camera.fy == pytest.approx(content["fl_x"] / content["fl_y"], rel=FLOAT64_VALUE)


def test_fox_is_the_same_through_colmap(real_data):
    a, b = load_scene(real_data(FOX)), load_scene(real_data(FOX), layout="colmap")
    for one, other in zip(a.views, b.views, strict=True):
        assert one.source == other.source
        np.testing.assert_allclose(one.camera.world_to_camera, other.camera.world_to_camera, atol=SAME_POSE)
        assert one.camera.fx == pytest.approx(other.camera.fx, rel=FLOAT64_VALUE)
    assert all(np.array_equal(x, y) for x, y in zip(a.points.views, b.points.views, strict=True))


@pytest.mark.slow
def test_fox_points_land_on_their_undistorted_keypoints(real_data):
    """Keypoints were found in the distorted photographs; undistorted, they are where the straight cameras see them."""
    scene = load_scene(real_data(FOX))
    folder = real_data(FOX) / "sparse" / "0"
    model, raw = read_model(folder), pycolmap.Reconstruction(str(folder))
    points = {key: index for index, key in enumerate(sorted(raw.points3D))}
    images = {image.name: image for image in raw.images.values()}
    errors, given, enlarged = [], [], []
    for view, name, lens in zip(scene.views, model.names, model.intrinsics, strict=True):
        marks = [mark for mark in images[name].points2D if mark.has_point3D()]
        rows = np.array([points[mark.point3D_id] for mark in marks])
        keypoints = np.array([mark.xy for mark in marks])
        straight = undistorted(lens)
        assert view.camera.fx == pytest.approx(straight.fx, abs=UNDISTORTED_PIXEL)
        found = undistort_points(lens, keypoints) * (straight.fx, straight.fy) + (straight.cx, straight.cy)
        projected, _ = view.camera.project(scene.points.xyz[rows])
        errors.append(np.linalg.norm(projected - found, axis=1))
        seen = np.array([images[name].project_point(xyz) for xyz in scene.points.xyz[rows]])
        given.append(np.linalg.norm(seen - keypoints, axis=1))
        enlarged.append(straight.fx / lens.fx)
        index = scene.views.index(view)
        assert all(index in scene.points.views[row] for row in rows)
    mean = np.concatenate(errors).mean()
    # COLMAP's own projection through its distorted camera, against the distorted keypoints, says the same.
    assert mean == pytest.approx(np.concatenate(given).mean() * np.mean(enlarged), rel=REPROJECTION_STRETCH)
