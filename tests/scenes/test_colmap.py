"""COLMAP models: text and binary, camera models, sub-folders, damage."""

import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from tolerances import POSE_ROUND_TRIP, UNDISTORTED_PIXEL

from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap
from dofbench.scenes.named import resolve
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.undistort import undistorted

NAMES = ["c.png", "a.png", "b.png"]


@pytest.fixture
def scene_folder(tmp_path, make_cameras, make_cloud, write_images):
    """Three views, named out of order, with points and tracks."""
    cameras = make_cameras(3)
    write_images(tmp_path / "images", NAMES)
    write_colmap(tmp_path, NAMES, cameras, make_cloud(cameras))
    return tmp_path


@pytest.fixture
def model(scene_folder):
    return scene_folder / "sparse" / "0"


def replace_camera(model, name, parameters, size=(48, 36)):
    """Give all images of the model another camera."""
    number = int(getattr(pycolmap.CameraModelId, name))
    content = struct.pack("<QIiQQ", 1, 1, number, *size) + struct.pack(f"<{len(parameters)}d", *parameters)
    (model / "cameras.bin").write_bytes(content)


def test_views_are_sorted_and_tracks_follow(scene_folder, make_cameras, make_cloud):
    cameras = make_cameras(3)
    cloud = make_cloud(cameras)
    scene = load_scene(scene_folder)
    assert [view.name for view in scene.views] == ["a", "b", "c"]
    for view, given in zip(scene.views, (1, 2, 0), strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, cameras[given].world_to_camera, atol=POSE_ROUND_TRIP)
    place = {1: 0, 2: 1, 0: 2}
    for found, expected in zip(scene.points.views, cloud.views, strict=True):
        assert found.tolist() == sorted(place[view] for view in expected)


@pytest.mark.parametrize("extra_files", [True, False])
def test_text_models(scene_folder, model, extra_files):
    expected = load_scene(scene_folder)
    reconstruction = pycolmap.Reconstruction(str(model))
    for file in model.iterdir():
        file.unlink()
    reconstruction.write_text(str(model))
    if not extra_files:  # as COLMAP before 3.12 wrote it
        (model / "rigs.txt").unlink()
        (model / "frames.txt").unlink()
    found = load_scene(scene_folder)
    for a, b in zip(found.views, expected.views, strict=True):
        np.testing.assert_allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=POSE_ROUND_TRIP)
    np.testing.assert_allclose(found.points.xyz, expected.points.xyz)


def test_a_new_binary_model_and_one_directly_in_sparse(scene_folder, model):
    expected = load_scene(scene_folder)
    pycolmap.Reconstruction(str(model)).write_binary(str(model))
    assert (model / "rigs.bin").is_file()
    found = load_scene(scene_folder)
    assert [view.name for view in found.views] == [view.name for view in expected.views]
    for file in list(model.iterdir()):
        file.rename(model.parent / file.name)
    assert load_scene(scene_folder).layout == "colmap"


def test_unregistered_images_are_left_out_and_sub_folders_keep_names_apart(tmp_path, make_cameras, write_images):
    names = ["left/0.png", "right/0.png"]
    write_images(tmp_path / "images", [*names, "right/1.png"])
    write_colmap(tmp_path, names, make_cameras(2), None)
    assert [view.name for view in load_scene(tmp_path).views] == ["left_0", "right_0"]


def test_other_suffix_and_size_of_the_images(scene_folder, write_images, make_cameras):
    write_images(scene_folder / "images_2", NAMES, (24, 18))
    for path in list((scene_folder / "images").iterdir()):
        path.rename(path.with_suffix(".bmp"))
    scene = load_scene(scene_folder, width=24)
    assert scene.views[0].source.parent.name == "images_2"
    assert scene.views[0].camera.fx == pytest.approx(make_cameras(3)[1].fx / 2)


def test_views_of_different_size(tmp_path, make_cameras, write_images):
    cameras = [make_cameras(1)[0], make_cameras(2, size=(60, 60))[1]]
    write_images(tmp_path / "images", ["a.png"])
    write_images(tmp_path / "images", ["b.png"], (60, 60))
    write_colmap(tmp_path, ["a.png", "b.png"], cameras, None)
    assert [view.image().shape[:2] for view in load_scene(tmp_path).views] == [(36, 48), (60, 60)]
    assert [view.image().shape[:2] for view in load_scene(tmp_path, width=40).views] == [(30, 40), (40, 40)]


@pytest.mark.parametrize(
    ("name", "parameters", "distortion", "fisheye"),
    [
        ("SIMPLE_PINHOLE", [50, 24, 18], (), False),
        ("PINHOLE", [50, 51, 24, 18], (), False),
        ("SIMPLE_RADIAL", [50, 24, 18, 0.02], (0.02,), False),
        ("RADIAL", [50, 24, 18, 0.02, 0.01], (0.02, 0.01), False),
        ("OPENCV", [50, 51, 24, 18, 0.02, 0.01, 0.001, 0.002], (0.02, 0.01, 0.001, 0.002), False),
        (
            "FULL_OPENCV",
            [50, 51, 24, 18, 0.02, 0.01, 0.001, 0.002, 0.003, 0.01, 0.02, 0.001],
            (0.02, 0.01, 0.001, 0.002, 0.003, 0.01, 0.02, 0.001),
            False,
        ),
        ("SIMPLE_RADIAL_FISHEYE", [50, 24, 18, 0.02], (0.02,), True),
        ("RADIAL_FISHEYE", [50, 24, 18, 0.02, 0.01], (0.02, 0.01), True),
        ("OPENCV_FISHEYE", [50, 51, 24, 18, 0.02, 0.01, 0.003, 0.004], (0.02, 0.01, 0.003, 0.004), True),
    ],
)
def test_camera_models_are_colmaps(scene_folder, model, name, parameters, distortion, fisheye):
    replace_camera(model, name, parameters)
    lens = read_model(model).intrinsics[0]
    assert lens.distortion == distortion and lens.fisheye == fisheye
    # The same ray through COLMAP's own camera and through ours.
    from dofbench.scenes.undistort import distort

    camera = next(iter(pycolmap.Reconstruction(str(model)).cameras.values()))
    rays = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 2))
    expected = camera.img_from_cam(np.column_stack([rays, np.ones(50)]))
    ours = distort(lens, rays) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    np.testing.assert_allclose(ours, expected, atol=UNDISTORTED_PIXEL)
    view = load_scene(scene_folder).views[0]
    straight = undistorted(lens)
    assert (view.camera.fx, view.camera.cx) == (straight.fx, straight.cx)
    assert view.image().shape == (36, 48, 3)


@pytest.mark.parametrize(
    ("name", "parameters", "size", "found"),
    [
        ("FOV", [50, 51, 24, 18, 0.1], (48, 36), "camera model FOV"),
        ("THIN_PRISM_FISHEYE", [50, 51, 24, 18, *[0.0] * 8], (48, 36), "camera model THIN_PRISM_FISHEYE"),
        ("PINHOLE", [50, 51, 24, 18], (0, 36), "0x36"),
        ("PINHOLE", [50, -51, 24, 18], (48, 36), "focal lengths 50.0, -51.0"),
        ("PINHOLE", [50, float("nan"), 24, 18], (48, 36), "nan"),
        ("SIMPLE_RADIAL", [50, 24, 18, -3.0], (48, 36), "folds"),
        ("PINHOLE", [50, 51, 24, 18], (48, 48), "48x36 pixels"),
    ],
)
def test_unusable_cameras_are_named(scene_folder, model, name, parameters, size, found):
    replace_camera(model, name, parameters, size)
    with pytest.raises(InputError, match=found) as caught:
        load_scene(scene_folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("part", ["cameras", "images", "points3D", "rigs", "frames"])
@pytest.mark.parametrize("keep", [0.0, 0.4, 0.9, "one more"])
def test_damaged_binary_files_are_named(scene_folder, model, part, keep):
    pycolmap.Reconstruction(str(model)).write_binary(str(model))
    file = model / f"{part}.bin"
    content = file.read_bytes()
    file.write_bytes(content + b"\0" if keep == "one more" else content[: int(len(content) * keep)])
    with pytest.raises(InputError, match=f"{part}.bin: found .* bytes"):
        load_scene(scene_folder)


def at(offset, code, *values):
    """Overwrite the bytes of a file at an offset."""

    def change(content):
        new = struct.pack(code, *values)
        return content[:offset] + new + content[offset + len(new) :]

    return change


@pytest.mark.parametrize(
    ("part", "change", "found"),
    [
        ("cameras", at(12, "<i", 77), "camera model number 77"),
        ("images", at(12, "<4d", *[float("nan")] * 4), "NaN or infinity"),
        ("images", at(12, "<4d", *[0.0] * 4), "a rotation of length 0"),
        ("images", at(68, "<I", 9), "no readable COLMAP model"),
        ("images", at(0, "<Q", 0), "bytes after the end"),
        ("points3D", at(16, "<d", float("inf")), "points with NaN or infinity"),
        ("points3D", at(59, "<I", 9), "no readable COLMAP model"),
        ("points3D", at(63, "<I", 999), "no readable COLMAP model"),
    ],
)
def test_wrong_contents_are_named(scene_folder, model, part, change, found):
    file = model / f"{part}.bin"
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(InputError, match=found) as caught:
        load_scene(scene_folder)
    assert str(model) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("part", ["cameras", "images", "points3D"])
def test_text_that_is_no_model(scene_folder, model, part):
    reconstruction = pycolmap.Reconstruction(str(model))
    for file in model.iterdir():
        file.unlink()
    reconstruction.write_text(str(model))
    (model / f"{part}.txt").write_text("this is no model\nat all\n")
    with pytest.raises(InputError, match=rf"no readable COLMAP model|{part}\.txt: found line 1"):
        load_scene(scene_folder)


def test_model_without_images(tmp_path, make_cameras, write_images):
    write_images(tmp_path / "images", ["a.png"])
    write_colmap(tmp_path, [], [], None)
    with pytest.raises(InputError, match=r"images.bin: found no image with a pose"):
        load_scene(tmp_path)


def test_missing_image_and_missing_model(scene_folder, model):
    (scene_folder / "images" / "b.png").unlink()
    with pytest.raises(InputError, match=r"images: found no image for b.png"):
        load_scene(scene_folder)
    (model / "images.bin").unlink()
    with pytest.raises(InputError, match="no COLMAP model"):
        load_scene(scene_folder, layout="colmap")
    with pytest.raises(InputError, match="no COLMAP model"):
        read_model(model)


def test_points_that_no_posed_image_saw_have_empty_tracks(scene_folder, make_cameras, make_cloud):
    cameras = make_cameras(3)
    cloud = make_cloud(cameras)
    some = replace(cloud, views=(cloud.views[0], *[np.empty(0, int)] * (len(cloud) - 1)))
    write_colmap(scene_folder, NAMES, cameras, some)
    views = load_scene(scene_folder).points.views
    assert len(views[0]) == len(cloud.views[0]) and all(len(track) == 0 for track in views[1:])


def test_no_camera_sees_a_point_behind_it(scene_folder, model, make_cameras, make_cloud):
    cloud = make_cloud(make_cameras(3))
    file = model / "points3D.bin"
    file.write_bytes(at(32, "<d", -5.0)(file.read_bytes()))  # z of the first point; its track stays
    points = load_scene(scene_folder).points
    assert points.xyz[0, 2] == -5.0 and len(cloud.views[0]) > 0
    assert len(points.views[0]) == 0
    assert [len(track) for track in points.views[1:]] == [len(track) for track in cloud.views[1:]]


@pytest.mark.parametrize("inside", ["", "dense/0", "dense/12", "dense"])
@pytest.mark.parametrize("place", [".", "sparse", "sparse/0"])
def test_a_scene_is_called_after_the_folder_that_a_person_named(
    scene_folder, tmp_path_factory, monkeypatch, inside, place
):
    root = tmp_path_factory.mktemp("scenes") / "chess" / inside
    shutil.copytree(scene_folder, root)
    assert load_scene(root / place).name == "chess"
    (found,) = resolve(str(root / place), None)
    assert (found.name, found.label, found.load().name) == ("chess", "chess", "chess")
    assert found.root.resolve() == root.resolve(), "what stands beside the images is looked for there"
    monkeypatch.chdir(root / place)
    assert load_scene(Path()).name == "chess"


def test_a_numbered_scene_and_another_of_its_models(scene_folder, tmp_path_factory, model):
    root = tmp_path_factory.mktemp("scans") / "24"
    shutil.copytree(scene_folder, root)
    assert load_scene(root).name == "24" == load_scene(root / "sparse" / "0").name
    shutil.copytree(model, model.parent / "1")
    with pytest.raises(InputError, match=r"sparse/1: found a model of 3 images"):
        load_scene(model.parent / "1")
