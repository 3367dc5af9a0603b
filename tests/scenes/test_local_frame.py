"""Scenes far from their origin: the same rays and points as near it, and their own coordinates in exported files."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import ply_text
from tolerances import FAR_POSITION

from dofbench.core.cameras import NO_OFFSET
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms
from dofbench.scenes.local_frame import AnotherFrame, local_offset

NAMES = [f"v{index}.png" for index in range(5)]
UTM = (448262.0, 5411932.0, 135.0)
ANYWHERE = st.floats(-1e7, 1e7, allow_subnormal=False)


class Far:
    """A scene in a folder, and the cameras and points that it has near the origin."""

    def __init__(self, folder, cameras, cloud):
        self.folder, self.cameras, self.cloud = folder, cameras, cloud

    def written(self, layout, at, cameras=None, **changes):
        """The scene written at another place by adding numbers to positions, and read."""
        cloud = replace(self.cloud, **changes)
        placed = replace(cloud, xyz=cloud.xyz + at)
        moved = [placed_at(camera, camera.centre + at) for camera in cameras or self.cameras]
        for file in ("transforms.json", "poses_bounds.npy"):
            (self.folder / file).unlink(missing_ok=True)
        write_colmap(self.folder, NAMES, moved, placed)
        if layout == "nerfstudio":
            write_transforms(self.folder / "transforms.json", [f"images/{name}" for name in NAMES], moved)
        if layout == "llff":
            write_poses_bounds(self.folder / "poses_bounds.npy", moved, np.tile([1.0, 9.0], (len(NAMES), 1)))
        return load_scene(self.folder)


def placed_at(camera, centre):
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ centre
    return replace(camera, world_to_camera=pose)


@pytest.fixture(scope="module")
def far(tmp_path_factory, make_cameras, make_cloud, write_images):
    folder = tmp_path_factory.mktemp("far")
    write_images(folder / "images", NAMES)
    cameras = make_cameras(5)
    return Far(folder, cameras, make_cloud(cameras))


def load_half(far, cameras):
    """The scene with only these cameras, without points."""
    shutil.rmtree(far.folder / "sparse", ignore_errors=True)
    names = [f"images/{name}" for name in NAMES[: len(cameras)]]
    write_transforms(far.folder / "transforms.json", names, cameras)
    return load_scene(far.folder)


def assert_same_views(scene, far):
    """Points before every camera, and centres among each other, are as they are near the origin."""
    for view, camera in zip(scene.views, far.cameras, strict=True):
        to_camera = [one.world_to_camera for one in (view.camera, camera)]
        xyz = [points @ pose[:3, :3].T + pose[:3, 3] for points, pose in zip(
            (scene.points.xyz, far.cloud.xyz), to_camera, strict=True)]  # fmt: skip
        np.testing.assert_allclose(*xyz, rtol=0, atol=FAR_POSITION)
    centres = [
        np.array([camera.centre for camera in cameras])
        for cameras in ([view.camera for view in scene.views], far.cameras)
    ]
    np.testing.assert_allclose(*(one - one[0] for one in centres), rtol=0, atol=FAR_POSITION)


@pytest.mark.parametrize("layout", ["colmap", "nerfstudio", "llff"])
@given(st.tuples(ANYWHERE, ANYWHERE, ANYWHERE))
def test_a_moved_scene_has_the_same_rays_and_points(far, layout, at):
    scene = far.written(layout, np.array(at))
    assert scene.layout == layout
    assert_same_views(scene, far)
    # In float32, where everything is trained, positions keep their digits.
    assert (
        np.abs(scene.points.xyz).max() < 1000 and max(np.abs(view.camera.centre).max() for view in scene.views) < 1000
    )
    assert bool(scene.notes) is (scene.offset != NO_OFFSET)


@given(st.tuples(ANYWHERE, ANYWHERE, ANYWHERE))
def test_the_offset_added_gives_the_files_points_to_a_bit(far, at):
    scene = far.written("colmap", np.array(at))
    stored = pycolmap.Reconstruction(far.folder / "sparse" / "0")
    xyz = np.array([stored.points3D[key].xyz for key in sorted(stored.points3D)])
    step = np.spacing(np.maximum(np.abs(xyz), np.abs(scene.points.xyz)))
    assert (np.abs(scene.points.xyz + np.array(scene.offset) - xyz) <= step).all()


def test_an_ordinary_scene_keeps_its_bits(far):
    scene = far.written("colmap", np.array([3.0, -20.0, 1.0]))
    stored = pycolmap.Reconstruction(far.folder / "sparse" / "0")
    assert scene.offset == NO_OFFSET and not scene.notes
    for index, view in enumerate(scene.views):
        assert np.array_equal(view.camera.world_to_camera[:3], stored.images[index + 1].cam_from_world().matrix())
    assert np.array_equal(scene.points.xyz, [stored.points3D[key].xyz for key in sorted(stored.points3D)])


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), UTM])
def test_a_point_far_outside_moves_nothing(far, at):
    usual = far.written("colmap", np.array(at))
    xyz = far.cloud.xyz.copy()
    xyz[3] = 1e9, -1e9, 1e9
    scene = far.written("colmap", np.array(at), xyz=xyz, views=None)
    assert scene.offset == usual.offset and len(scene.points) == len(xyz) - 1
    assert np.array_equal(scene.points.xyz, np.delete(usual.points.xyz, 3, axis=0))
    assert any("1 of 40 points" in note for note in scene.notes)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), UTM])
@pytest.mark.parametrize("away", [1e6, 1e9, 1e200])
def test_a_camera_far_outside_is_named(far, at, away):
    cameras = list(far.cameras)
    cameras[2] = placed_at(cameras[2], np.array([away, 0.0, 0.0]))
    with pytest.raises(InputError, match="camera of v2 .* scene units away"):
        far.written("colmap", np.array(at), cameras, views=None)


@pytest.mark.parametrize("which", ["points", "cameras"])
def test_points_and_cameras_in_two_frames_are_named(far, which):
    """All points may fall on one pixel, inside of an image."""
    far.written("nerfstudio", np.zeros(3))
    shutil.rmtree(far.folder / "sparse")
    file = far.folder / "transforms.json"
    content = read_json(file) | {"ply_file_path": "points.ply"}
    ahead = far.cameras[0].camera_to_world[:3, 2] * 5e6
    xyz = far.cloud.xyz + (ahead if which == "points" else 0)
    (far.folder / "points.ply").write_text(ply_text(xyz))
    for frame in content["frames"]:
        for row, value in zip(frame["transform_matrix"][:3], UTM, strict=True):
            row[3] += value if which == "cameras" else 0.0
    write_json(file, content)
    with pytest.raises(AnotherFrame, match="points|inside"):
        load_scene(far.folder)


def test_of_two_frames_with_half_of_the_cameras_each_one_is_named(far):
    cameras = [placed_at(camera, camera.centre + UTM) for camera in far.cameras[:2]]
    cameras = [*cameras, *far.cameras[2:4]]
    with pytest.raises(InputError, match="scene units away"):
        load_half(far, cameras)


def test_positions_that_float32_rounded_are_named(far):
    scene = far.written("nerfstudio", np.array(UTM))
    assert len(scene.notes) == 1
    content = read_json(far.folder / "transforms.json")
    for frame in content["frames"]:
        for row in frame["transform_matrix"][:3]:
            row[3] = float(np.float32(row[3]))
    write_json(far.folder / "transforms.json", content)
    shutil.rmtree(far.folder / "sparse")  # its cameras contradict the rounded ones, which is an error of its own
    (moved, rounded) = load_scene(far.folder, layout="nerfstudio").notes
    assert "camera positions" in rounded and "0.5 scene units" in rounded and "far from the origin" in moved


def test_a_scene_without_extent_stays():
    assert local_offset(np.array([UTM, UTM]), None) == NO_OFFSET


def test_the_offset_is_found_whatever_the_scenes_unit(far):
    for unit in (1e-3, 1.0, 1e4):
        centres = unit * np.array([camera.centre + UTM for camera in far.cameras])
        offset = local_offset(centres, PointCloud(unit * (far.cloud.xyz + UTM), far.cloud.rgb, far.cloud.error))
        assert np.abs(np.array(offset) / unit - UTM).max() < 10


@pytest.mark.parametrize(("digits", "named"), [(17, ""), (6, "note"), (3, "error")])
def test_cameras_misplaced_by_rounded_rotations_are_named(far, digits, named):
    far.written("colmap", np.array(UTM))
    model = far.folder / "sparse" / "0"
    read = pycolmap.Reconstruction(model)
    read.update_point_3d_errors()
    shutil.rmtree(model)
    model.mkdir()
    read.write_text(model)
    for newer in ("rigs.txt", "frames.txt"):
        (model / newer).unlink()
    lines = (model / "images.txt").read_text().splitlines()
    first = next(index for index, line in enumerate(lines) if not line.startswith("#"))
    for index in range(first, len(lines), 2):
        words = lines[index].split()
        words[1:5] = [f"{float(word):.{digits}g}" for word in words[1:5]]
        lines[index] = " ".join(words)
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    if named == "error":
        with pytest.raises(InputError, match="rotations"):
            load_scene(far.folder, layout="colmap")
    else:
        notes = load_scene(far.folder, layout="colmap").notes
        assert any("rotations" in note for note in notes) is bool(named)
    shutil.rmtree(model)
