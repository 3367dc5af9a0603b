"""transforms.json: intrinsics, distortion, depth, splits, and every way to get it wrong."""

import math

import cv2
import numpy as np
import pytest
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE, LEVEL_8BIT, POSE_ROUND_TRIP, ROUNDED_ROTATION
from transforms_file import FILES, edit

from dofbench.core.errors import InputError
from dofbench.core.images import write_exr
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_transforms
from dofbench.scenes.undistort import Intrinsics, undistorted


@pytest.fixture
def folder(transforms_folder):
    return transforms_folder


def test_views(folder, make_cameras):
    scene = load_scene(folder)
    assert scene.layout == "nerfstudio" and scene.points is None
    assert [view.split for view in scene.views] == ["test", "train", "train", "train"]
    for view, camera in zip(scene.views, make_cameras(4), strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)
        assert view.image().shape == (36, 48, 3) and view.depth is None


def test_field_of_view_instead_of_a_focal_length(folder):
    def change(content):
        for name in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            del content[name]
        content["camera_angle_x"] = 0.8

    edit(folder, change)
    camera = load_scene(folder).views[0].camera
    focal = 24 / math.tan(0.4)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((focal, focal, 24, 18), rel=FLOAT64_VALUE)
    edit(folder, lambda content: content.update(camera_angle_y=0.7))
    assert load_scene(folder).views[0].camera.fy == pytest.approx(18 / math.tan(0.35), rel=FLOAT64_VALUE)


def test_intrinsics_of_a_frame_win(folder):
    edit(folder, lambda content: content["frames"][2].update(fl_x=61.0, cx=20.0))
    views = load_scene(folder).views
    assert (views[2].camera.fx, views[2].camera.cx) == (61.0, 20.0)
    assert (views[1].camera.fx, views[1].camera.cx) == (pytest.approx(52.8), 24.0)


@pytest.mark.parametrize(
    ("entries", "distortion", "fisheye"),
    [
        ({"k1": 0.05, "k2": -0.08, "p1": -0.001, "p2": 0.002}, (0.05, -0.08, -0.001, 0.002), False),
        ({"k1": 0.05, "k3": 0.01, "camera_model": "OPENCV"}, (0.05, 0.0, 0.0, 0.0, 0.01), False),
        ({"k1": 0.05, "k4": 0.01, "camera_model": "FULL_OPENCV"}, (0.05, 0.0, 0.0, 0.0, 0.0, 0.01), False),
        ({"k1": 0.03, "k4": 0.01, "camera_model": "OPENCV_FISHEYE"}, (0.03, 0.0, 0.0, 0.01), True),
        ({"k1": 0.03, "is_fisheye": True, "camera_model": None}, (0.03,), True),
    ],
)
def test_distortion(folder, entries, distortion, fisheye):
    edit(folder, lambda content: content.update(entries))
    given = Intrinsics(48, 36, 1.1 * 48, 1.1 * 48, 24, 18, distortion, fisheye)
    camera = load_scene(folder).views[0].camera
    expected = undistorted(given)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(
        (expected.fx, expected.fy, expected.cx, expected.cy), rel=FLOAT64_VALUE
    )
    assert camera.fx != given.fx


def _first(content):
    return content["frames"][0]


def _angle(degrees, content):
    for name in ("fl_x", "fl_y"):
        content.pop(name)
    content["camera_angle_x"] = degrees


def test_principal_points_and_extra_images_are_named(folder, write_images):
    edit(folder, lambda content: content["frames"][2].update(cx=37.0))
    assert any("1 of 4 views far from the middle" in note and "37, 18" in note for note in load_scene(folder).notes)
    edit(folder, lambda content: content["frames"][2].update(cx=35.0))
    assert not load_scene(folder).notes
    write_images(folder, ["images/extra.png"])
    scene = load_scene(folder)
    assert any("5 images in images, 4 with a pose" in note and "extra.png" in note for note in scene.notes)


@pytest.mark.parametrize("scale", [0.35, 1.0])
def test_rounded_and_scaled_matrices_are_read_and_said(folder, scale):
    expected = load_scene(folder)

    def change(content):
        for frame in content["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, :3] = scale * matrix[:3, :3].round(3)
            frame["transform_matrix"] = matrix[:3].tolist()

    edit(folder, change)
    scene = load_scene(folder)
    for found, given in zip(scene.views, expected.views, strict=True):
        assert np.abs(found.camera.world_to_camera - given.camera.world_to_camera).max() < ROUNDED_ROTATION
    assert any(("scaled" if scale != 1 else "rounded") in note for note in scene.notes) and not expected.notes


@pytest.mark.parametrize(
    ("written", "suffix"), [("", ".PNG"), (".png", ".PNG"), (".jpg", ".png"), (".JPG", ".png"), (".png", ".png")]
)
@pytest.mark.parametrize("slash", ["/", "\\"])
def test_suffixes_slashes_and_a_byte_order_mark(folder, written, suffix, slash):
    expected = load_scene(folder)
    for file in sorted((folder / "images").iterdir()):
        file.rename(file.with_suffix(suffix))

    def change(content):
        for frame in content["frames"]:
            name = frame["file_path"].removesuffix(".png") + written
            frame["file_path"] = f".{slash}{name.replace('/', slash)}"

    edit(folder, change)
    file = folder / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    scene = load_scene(folder)
    assert [view.source.name for view in scene.views] == [f"{index}{suffix}" for index in range(4)]
    for found, given in zip(scene.views, expected.views, strict=True):
        assert np.array_equal(found.camera.world_to_camera, given.camera.world_to_camera)
    assert bool(scene.notes) == (written.lower() == ".jpg")


def test_a_suffix_that_two_images_could_have_is_refused(folder, write_images):
    write_images(folder, ["images/0.tif.png"])
    (folder / "images/0.tif.png").rename(folder / "images/0.tif")
    edit(folder, lambda content: content["frames"][0].update(file_path="images/0.jpg"))
    with pytest.raises(InputError, match=r"several images for images/0\.jpg"):
        load_scene(folder)
    edit(folder, lambda content: content["frames"][0].update(file_path="images/0.PNG"))
    assert load_scene(folder).views[0].source.name == "0.png"


def test_absolute_paths_in_the_folder_are_read(folder):
    expected = load_scene(folder)

    def change(content):
        for frame in content["frames"]:
            frame["file_path"] = str((folder / frame["file_path"]).absolute())

    edit(folder, change)
    assert [view.source for view in load_scene(folder).views] == [view.source for view in expected.views]


def test_smaller_folder_for_a_smaller_width(folder, write_images, make_cameras):
    write_images(folder, [name.replace("images", "images_2") for name in FILES], (24, 18))
    for options, source, width in (
        ({}, "images", 48),
        ({"width": 24}, "images_2", 24),
        ({"width": 20}, "images_2", 20),
        ({"width": 30}, "images", 30),
        ({"images": "images_2"}, "images_2", 24),
    ):
        view = load_scene(folder, **options).views[1]
        assert view.source.parent.name == source
        assert view.camera.width == width and view.image().shape[1] == width
        assert view.camera.fx == pytest.approx(make_cameras(4)[1].fx * width / 48)
    with pytest.raises(InputError, match="nothing is enlarged"):
        load_scene(folder, width=49)


def test_images_beside_the_file(tmp_path, make_cameras, write_images):
    write_images(tmp_path, ["a.png", "b.png"])
    write_transforms(tmp_path / "transforms.json", ["a.png", "b.png"], make_cameras(2))
    assert load_scene(tmp_path, width=24).views[0].camera.width == 24
    with pytest.raises(InputError, match="one folder, to read images_2 instead"):
        load_scene(tmp_path, images="images_2")


def test_depth_from_exr_png_and_several_channels(folder, make_cameras):
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 9, (36, 48)).astype(np.float32)
    depth[0, :2] = (0.0, np.inf)
    levels = rng.integers(0, 65536, (36, 48)).astype(np.uint16)
    write_exr(folder / "depth" / "0.exr", depth)
    write_exr(folder / "depth" / "1.exr", np.repeat(depth[..., None], 3, axis=2))
    cv2.imwrite(str(folder / "depth" / "2.png"), levels)

    def change(content):
        for index, name in enumerate(("0.exr", "1.exr", "2.png")):
            content["frames"][index]["depth_file_path"] = f"depth/{name}"

    edit(folder, change)
    views = load_scene(folder).views
    known = np.where(np.isfinite(depth), depth, 0)
    assert np.array_equal(views[0].depth(), known)
    assert np.array_equal(views[1].depth(), known)
    np.testing.assert_allclose(views[2].depth(), levels * np.float32(1e-3), rtol=FLOAT32_VALUE)
    assert views[3].depth is None
    edit(folder, lambda content: content.update(depth_unit_scale_factor=0.25))
    views = load_scene(folder).views
    assert np.array_equal(views[0].depth(), known * np.float32(0.25))
    assert np.array_equal(views[2].depth(), levels * np.float32(0.25))
    half = load_scene(folder, width=24).views[0].depth()
    assert half.shape == (18, 24) and set(np.unique(half)) <= set(np.unique(known * np.float32(0.25)))


@pytest.mark.parametrize(
    "value, word", [(np.nan, "NaN in 12 of 1728"), (-1.0, "negative values in 12"), (None, "no pixel of known depth")]
)
def test_depth_that_cannot_be_is_refused(folder, value, word):
    depth = np.zeros((36, 48), np.float32)
    if value is not None:
        depth += 2
        depth[5, :12] = value
    write_exr(folder / "depth" / "0.exr", depth)
    edit(folder, lambda content: _first(content).update(depth_file_path="depth/0.exr"))
    with pytest.raises(InputError, match=rf"depth/0\.exr: found {word}"):
        load_scene(folder).views[0].depth()


def test_depth_follows_the_undistorted_image(folder):
    """Image and depth are the same ramp: they stay the same ramp after undistortion."""
    from dofbench.core.images import write_png

    ramp = np.tile(np.linspace(0.2, 0.8, 48, dtype=np.float32), (36, 1))
    write_png(folder / FILES[0], np.repeat(ramp[..., None], 3, axis=2))
    write_exr(folder / "depth.exr", ramp)

    def change(content):
        content.update(k1=0.1, k2=-0.05, p1=0.01)
        content["frames"][0]["depth_file_path"] = "depth.exr"

    edit(folder, change)
    view = load_scene(folder).views[0]
    step = 0.6 / 47
    # The nearest depth is half a pixel away at most.
    assert np.abs(view.image()[..., 0] - view.depth())[6:-6, 6:-6].max() < 0.5 * step + LEVEL_8BIT


@pytest.mark.parametrize(
    ("lists", "expected"),
    [
        ({"train_filenames": FILES[:2], "test_filenames": FILES[2:]}, ["train", "train", "test", "test"]),
        ({"train_filenames": FILES[:3]}, ["train", "train", "train", "test"]),
        ({"test_filenames": [f"./{FILES[1]}"]}, ["train", "test", "train", "train"]),
        (
            {"train_filenames": FILES[:2], "val_filenames": FILES[2:3], "test_filenames": FILES[3:]},
            ["train", "train", "test"],  # a view for validation alone is neither trained on nor scored
        ),
        (
            {"train_filenames": FILES[:2], "val_filenames": FILES[2:], "test_filenames": FILES[2:]},
            ["train", "train", "test", "test"],
        ),
    ],
)
def test_splits(folder, lists, expected):
    edit(folder, lambda content: content.update(lists))
    assert [view.split for view in load_scene(folder).views] == expected
    by_hold = [view.split for view in load_scene(folder, hold=2).views]
    assert by_hold == ["test", "train", "test", "train"][: len(expected)], "a hold that is asked for wins"


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda c: _angle(39.6, c), r"camera_angle_x 39\.6, expected radians.*0\.6912"),
        (lambda c: _angle(-0.5, c), "expected radians"),
        (lambda c: _angle(0.0, c), "expected radians"),
        (lambda c: c.update(cx=1e300), "cx 1e\\+300"),
        (lambda c: c.update(cx=1e9), r"a principal point of 1e\+09"),
        (lambda c: c.update(cy=-1e5), "a principal point"),
        (lambda c: c.update(cx=0.5, cy=0.5), "pixels .were these shares of the image, 24, 18"),
        (lambda c: c.update(cx=0.5), "pixels .were these shares"),
        (lambda c: c.update(fl_x=1e300), "fl_x 1e\\+300"),
        (lambda c: c.update(fl_x=1e9), r"focal lengths 1e\+09"),
        (lambda c: c.update(fl_x=0.9, fl_y=0.9), "focal lengths 0.9, 0.9"),  # in shares of the width
        (lambda c: c.update(fl_y=-52.8), "positive .*transform_matrix"),
        (lambda c: c["frames"][1]["transform_matrix"][0].__setitem__(3, 1e9), "away from the others"),
        *(
            (lambda c, key=key, path=path: _first(c).update({key: path}), "leads out of its folder|an absolute path")
            for key in ("file_path", "depth_file_path")
            for path in ("../elsewhere/0.png", "/etc/0.png", "C:\\0.png", "images/../../0.png")
        ),
        (lambda c: c["frames"][1].update(file_path="images/../images/0.png"), r"several frames for images/0\.png"),
        (lambda c: c.update(frames=[]), "no list of frames"),
        (lambda c: c.update(frames={"a": 1}), "no list of frames"),
        (lambda c: _first(c).pop("file_path"), "file_path None"),
        (lambda c: _first(c).update(file_path=3), "file_path 3"),
        (lambda c: _first(c).update(file_path="images/1.png"), "several frames for images/1.png"),
        (lambda c: _first(c).update(file_path="images/nothing"), "no image for images/nothing"),
        (lambda c: _first(c).pop("transform_matrix"), r"a pose of shape \(\)"),
        (lambda c: _first(c).update(transform_matrix=[[1, 2], [3]]), "no numbers"),
        (lambda c: _first(c).update(transform_matrix=np.zeros((4, 4)).tolist()), "last row"),
        (lambda c: _first(c).update(transform_matrix=np.diag([1, 1, 3, 1]).tolist()), "no rotation"),
        (lambda c: _first(c).update(transform_matrix=np.diag([1, 1, -1, 1]).tolist()), "mirrored"),
        (lambda c: _first(c).update(transform_matrix=np.full((4, 4), math.nan).tolist()), "NaN"),
        (lambda c: (c.pop("fl_x"), c.pop("fl_y")), "focal lengths None"),
        (lambda c: c.update(fl_x=-3), "focal lengths -3.0"),
        (lambda c: c.update(fl_x="wide"), "fl_x 'wide'"),
        (lambda c: c.update(w=48.5), "w 48.5"),
        (lambda c: c.update(h=48), "48x36 pixels, expected the shape of its camera, 48x48"),
        (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "camera_model EQUIRECTANGULAR"),
        (lambda c: c.update(k4=0.1), "k4 0.1"),
        (lambda c: c.update(k1=-5.0), "folds"),
        (lambda c: c.update(train_filenames="all"), "no list of paths"),
        (lambda c: c.update(train_filenames=["x.png"]), "x.png in train_filenames"),
        (lambda c: c.update(train_filenames=FILES, test_filenames=FILES[:1]), "images/0.png in both lists"),
        (lambda c: c.update(train_filenames=FILES[:2], test_filenames=FILES[2:3]), "images/3.png in neither list"),
        (lambda c: _first(c).update(depth_file_path="d.exr"), "d.exr: found no such file"),
        (lambda c: c.update(ply_file_path="p.ply"), "p.ply: found no such file"),
    ],
)
def test_wrong_contents_are_named(folder, change, found):
    edit(folder, change)
    with pytest.raises(InputError, match=found) as caught:
        load_scene(folder)
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '"frames"', "{}"])
def test_files_that_are_no_transforms(folder, text):
    (folder / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=r"transforms.json: found no (JSON|list of frames)"):
        load_scene(folder)


def test_wrong_depth_files_are_named(folder, write_images):
    write_images(folder, ["eight.png", "wrong.png"])
    write_images(folder, ["wrong.png"], (48, 40))
    (folder / "depth.tiff").write_bytes((folder / "eight.png").read_bytes())
    colours = np.random.default_rng(0).random((36, 48, 3)).astype(np.float32)
    write_exr(folder / "colours.exr", colours)
    for name, found in (
        ("eight.png", "a PNG of uint8"),
        ("colours.exr", "3 different channels"),
        ("depth.tiff", "suffix .tiff"),
    ):
        edit(folder, lambda content, name=name: _first(content).update(depth_file_path=name))
        view = load_scene(folder).views[0]
        with pytest.raises(InputError, match=found):
            view.depth()
    edit(folder, lambda content: _first(content).update(depth_file_path="wrong.png"))
    with pytest.raises(InputError, match=r"wrong.png: found 48x40 pixels"):
        load_scene(folder)


def test_layout_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path, layout="nerfstudio")
