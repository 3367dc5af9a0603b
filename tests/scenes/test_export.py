"""What the writers write, the readers (ours, and a plain one of the classic layout) read back."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE, LEVEL_8BIT, POSE_ROUND_TRIP

from dofbench.core.cameras import Camera
from dofbench.core.images import write_exr, write_png
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms


def assert_same_camera(found, expected, tolerance=POSE_ROUND_TRIP):
    assert (found.width, found.height) == (expected.width, expected.height)
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=FLOAT64_VALUE), name
    np.testing.assert_allclose(found.world_to_camera, expected.world_to_camera, atol=tolerance)


def names(count):
    return [f"view{index:03d}.png" for index in range(count)]


def plain_colmap(folder):
    """The classic binary layout, read as 3DGS programs do: cameras, images by name, points."""
    content, at = (folder / "cameras.bin").read_bytes(), 8
    cameras = {}
    for _ in range(struct.unpack_from("<Q", content)[0]):
        key, model, width, height = struct.unpack_from("<iiQQ", content, at)
        assert model == 1, "PINHOLE"
        cameras[key] = (width, height, *struct.unpack_from("<4d", content, at + 24))
        at += 24 + 32
    assert at == len(content)
    content, at = (folder / "images.bin").read_bytes(), 8
    images = {}
    for _ in range(struct.unpack_from("<Q", content)[0]):
        key, *pose, camera = struct.unpack_from("<i7di", content, at)
        end = content.index(b"\0", at + 64)
        count = struct.unpack_from("<Q", content, end + 1)[0]
        marks = [struct.unpack_from("<ddq", content, end + 9 + 24 * i) for i in range(count)]
        images[content[at + 64 : end].decode()] = (key, pose, camera, marks)
        at = end + 9 + 24 * count
    assert at == len(content)
    content, at = (folder / "points3D.bin").read_bytes(), 8
    points = []
    for _ in range(struct.unpack_from("<Q", content)[0]):
        key, x, y, z, r, g, b, error, length = struct.unpack_from("<Q3d3BdQ", content, at)
        track = [struct.unpack_from("<ii", content, at + 51 + 8 * i) for i in range(length)]
        points.append((key, (x, y, z), (r, g, b), error, track))
        at += 51 + 8 * length
    assert at == len(content)
    return cameras, images, points


@pytest.mark.parametrize("tracks", [True, False])
@pytest.mark.parametrize("square", [True, False])
def test_colmap_round_trip(tmp_path, make_cameras, make_cloud, write_images, tracks, square):
    cameras = make_cameras(square=square)
    cloud = make_cloud(cameras, tracks=tracks)
    write_images(tmp_path / "images", names(len(cameras)))
    write_colmap(tmp_path, names(len(cameras)), cameras, cloud)
    scene = load_scene(tmp_path)
    assert scene.layout == "colmap"
    for view, camera in zip(scene.views, cameras, strict=True):
        assert_same_camera(view.camera, camera)
    np.testing.assert_array_equal(scene.points.xyz, cloud.xyz)
    np.testing.assert_allclose(scene.points.rgb, cloud.rgb, atol=0.5 * LEVEL_8BIT)
    np.testing.assert_allclose(scene.points.error, cloud.error)
    assert (scene.points.views is None) == (not tracks)
    if tracks:
        assert all(np.array_equal(a, b) for a, b in zip(scene.points.views, cloud.views, strict=True))


def test_colmap_files_have_the_classic_layout(tmp_path, make_cameras, make_cloud):
    cameras = make_cameras(4)
    cameras[2] = replace(cameras[2], fx=70.0)
    cloud = make_cloud(cameras)
    cloud = replace(cloud, error=np.full(len(cloud), np.nan, np.float32))
    write_colmap(tmp_path, names(4), cameras, cloud)
    folder = tmp_path / "sparse" / "0"
    assert sorted(path.name for path in folder.iterdir()) == ["cameras.bin", "images.bin", "points3D.bin"]
    lenses, images, points = plain_colmap(folder)
    assert len(lenses) == 2, "one camera for every distinct intrinsics"
    for name, camera in zip(names(4), cameras, strict=True):
        _, (w, x, y, z, *translation), lens, marks = images[name]
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(rotation, camera.world_to_camera[:3, :3], atol=POSE_ROUND_TRIP)
        np.testing.assert_allclose(translation, camera.world_to_camera[:3, 3], atol=POSE_ROUND_TRIP)
        assert lenses[lens] == (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        for u, v, point in marks:
            np.testing.assert_allclose(camera.project(cloud.xyz[point - 1][None])[0][0], (u, v), atol=POSE_ROUND_TRIP)
    ids = {key: list(images).index(name) for name, (key, *_) in images.items()}
    order = {key: names(4).index(list(images)[place]) for key, place in ids.items()}
    for (key, xyz, _, error, track), views in zip(points, cloud.views, strict=True):
        assert xyz == tuple(cloud.xyz[key - 1]) and error == -1.0
        assert sorted(order[image] for image, _ in track) == views.tolist()


def test_llff_round_trip(tmp_path, make_cameras, write_images):
    cameras = make_cameras()
    bounds = np.random.default_rng(0).uniform(1, 9, (len(cameras), 2))
    write_images(tmp_path / "images", names(len(cameras)))
    assert write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, bounds) == []
    rows = np.load(tmp_path / "poses_bounds.npy")
    assert rows.shape == (len(cameras), 17) and rows.dtype == np.float64
    np.testing.assert_array_equal(rows[:, 15:], bounds)
    scene = load_scene(tmp_path)
    assert scene.layout == "llff" and scene.points is None
    for view, camera in zip(scene.views, cameras, strict=True):
        assert_same_camera(view.camera, camera)


def test_llff_says_what_it_loses(tmp_path, make_cameras):
    cameras = make_cameras(square=False)
    notes = write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.ones((len(cameras), 2)))
    assert len(notes) == 2 and "fx and fy" in notes[0] and "principal points" in notes[1]
    assert np.load(tmp_path / "poses_bounds.npy")[0, 14] == pytest.approx((cameras[0].fx + cameras[0].fy) / 2)
    with pytest.raises(ValueError, match="near_far"):
        write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.ones((2, 2)))


@pytest.mark.parametrize("distinct", [True, False])
def test_transforms_round_trip(tmp_path, make_cameras, write_images, distinct):
    cameras = make_cameras(square=False)
    if distinct:
        cameras[1] = replace(cameras[1], fx=80.0, cx=20.25)
    files = [f"images/{name}" for name in names(len(cameras))]
    depths = [f"depth/view{index}.exr" for index in range(len(cameras))]
    for index, depth in enumerate(depths):
        write_exr(tmp_path / depth, np.full((36, 48), index + 0.3, np.float32))
    write_images(tmp_path, files)
    splits = ["train", "test", "train", "train", "test"]
    extra = [{"aperture": index / 10} for index in range(len(cameras))]
    write_transforms(tmp_path / "transforms.json", files, cameras, depth_paths=depths, splits=splits, extra=extra)
    scene = load_scene(tmp_path)
    assert scene.layout == "nerfstudio"
    assert [view.split for view in scene.views] == splits
    for index, (view, camera) in enumerate(zip(scene.views, cameras, strict=True)):
        assert_same_camera(view.camera, camera)
        assert (view.depth() == np.float32(index + 0.3)).all()
    content = json.loads((tmp_path / "transforms.json").read_text())
    assert ("fl_x" in content) == (not distinct)
    assert [frame["aperture"] for frame in content["frames"]] == [0.0, 0.1, 0.2, 0.3, 0.4]


def test_three_layouts_of_one_scene_agree(tmp_path, make_cameras, make_cloud, write_images):
    cameras = make_cameras()
    cloud = make_cloud(cameras)
    write_images(tmp_path / "images", names(len(cameras)))
    write_colmap(tmp_path, names(len(cameras)), cameras, cloud)
    write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.ones((len(cameras), 2)))
    write_transforms(tmp_path / "transforms.json", [f"images/{name}" for name in names(len(cameras))], cameras)
    scenes = [load_scene(tmp_path, layout=layout) for layout in ("nerfstudio", "llff", "colmap")]
    for scene in scenes:
        assert [view.name for view in scene.views] == [Path(name).stem for name in names(len(cameras))]
        for view, camera in zip(scene.views, cameras, strict=True):
            assert_same_camera(view.camera, camera)
        np.testing.assert_array_equal(scene.points.xyz, cloud.xyz)
        assert all(np.array_equal(a, b) for a, b in zip(scene.points.views, cloud.views, strict=True))


def test_writing_twice_gives_the_same_bytes(tmp_path, make_cameras, make_cloud):
    cameras = make_cameras(7)
    cloud = make_cloud(cameras, 60)
    for name in ("first", "second"):
        write_colmap(tmp_path / name, names(7), cameras, cloud)
        write_poses_bounds(tmp_path / name / "poses_bounds.npy", cameras, np.ones((7, 2)))
        write_transforms(tmp_path / name / "transforms.json", names(7), cameras)
    files = [path.relative_to(tmp_path / "first") for path in (tmp_path / "first").rglob("*") if path.is_file()]
    assert len(files) == 5
    for file in files:
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes(), file


@given(seed=st.integers(0, 1000), count=st.integers(2, 4))
def test_any_pose_survives_every_layout(tmp_path_factory, seed, count):
    folder = tmp_path_factory.mktemp("scene")
    rng = np.random.default_rng(seed)
    cameras = []
    for _ in range(count):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation * np.linalg.det(rotation), rng.normal(0, 100, 3)
        cameras.append(Camera(48, 36, 50.0, 50.0, 24.0, 18.0, pose))
    write_colmap(folder, names(count), cameras, None)
    write_poses_bounds(folder / "poses_bounds.npy", cameras, np.ones((count, 2)))
    write_transforms(folder / "transforms.json", names(count), cameras)
    for name in names(count):
        write_png(folder / name, np.zeros((36, 48, 3), np.uint8))
        write_png(folder / "images" / name, np.zeros((36, 48, 3), np.uint8))
    for layout in ("colmap", "llff", "nerfstudio"):
        for view, camera in zip(load_scene(folder, layout=layout).views, cameras, strict=True):
            assert_same_camera(view.camera, camera)


def test_callers_mistakes_are_named(tmp_path, make_cameras, make_cloud):
    cameras = make_cameras(3)
    cloud = make_cloud(cameras)
    with pytest.raises(ValueError, match="file_names"):
        write_colmap(tmp_path, names(2), cameras, None)
    with pytest.raises(ValueError, match=r"points.views: expected indices from 0 to 1"):
        write_colmap(tmp_path, names(2), cameras[:2], cloud)
    behind = replace(cloud, xyz=-cloud.xyz)
    with pytest.raises(ValueError, match="behind its camera"):
        write_colmap(tmp_path, names(3), cameras, behind)
    with pytest.raises(ValueError, match="depth_paths"):
        write_transforms(tmp_path / "t.json", names(3), cameras, depth_paths=["a"])
    with pytest.raises(ValueError, match="splits"):
        write_transforms(tmp_path / "t.json", names(3), cameras, splits=["train"])
    with pytest.raises(ValueError, match="file_path belong"):
        write_transforms(tmp_path / "t.json", names(3), cameras, extra=[{"file_path": "x"}] * 3)
    assert not list(tmp_path.rglob("*.bin")) and not (tmp_path / "t.json").exists()
