"""LLFF folders: rows, images and points that belong together, and what happens when they don't."""

import numpy as np
import pytest
from tolerances import POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds


@pytest.fixture
def folder(tmp_path, make_cameras, write_images):
    """Five views at 96x72, 24x18 and 12x9; the poses are for 96x72."""
    cameras = make_cameras(5, size=(96, 72))
    for name, size in (("images", (96, 72)), ("images_4", (24, 18)), ("images_8", (12, 9))):
        write_images(tmp_path / name, [f"image{index}.png" for index in range(5)], size)
    write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (5, 1)))
    return tmp_path


@pytest.mark.parametrize(
    ("options", "size", "source"),
    [
        ({}, (12, 9), "images_8"),
        ({"width": 12}, (12, 9), "images_8"),
        ({"width": 20}, (20, 15), "images_4"),
        ({"width": 96}, (96, 72), "images"),
        ({"images": "images_4"}, (24, 18), "images_4"),
        ({"images": "images", "width": 10}, (10, 8), "images"),
    ],
)
def test_sizes_and_cameras(folder, make_cameras, options, size, source):
    scene = load_scene(folder, **options)
    full = make_cameras(5, size=(96, 72))
    for view, camera in zip(scene.views, full, strict=True):
        expected = camera.resized(*size)
        assert view.source.parent.name == source
        assert (view.camera.width, view.camera.height) == size
        assert (view.camera.fx, view.camera.fy) == pytest.approx((expected.fx, expected.fy))
        assert (view.camera.cx, view.camera.cy) == (size[0] / 2, size[1] / 2)
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)
        image = view.image()
        assert image.shape == (size[1], size[0], 3) and image.dtype == np.float32


def test_rows_belong_to_sorted_files_and_views_are_sorted_by_name(folder, make_cameras):
    # "image1-b.png" sorts before "image1.png" as a file, after "image1" as a view's name.
    for name in ("images", "images_4", "images_8"):
        (folder / name / "image4.png").rename(folder / name / "image1-b.png")
    scene = load_scene(folder)
    assert [view.name for view in scene.views] == ["image0", "image1", "image1-b", "image2", "image3"]
    rows = [0, 2, 1, 3, 4]
    full = make_cameras(5, size=(96, 72))
    for view, row in zip(scene.views, rows, strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, full[row].world_to_camera, atol=POSE_ROUND_TRIP)


def test_points_and_their_tracks(folder, make_cameras, make_cloud):
    cameras = make_cameras(5, size=(96, 72))
    cloud = make_cloud(cameras)
    write_colmap(folder, [f"IMG_{4026 + index}.JPG" for index in range(5)], cameras, cloud)
    scene = load_scene(folder)
    assert scene.layout == "llff"
    assert all(np.array_equal(a, b) for a, b in zip(scene.points.views, cloud.views, strict=True))
    cameras = make_cameras(5, size=(96, 72))
    cloud = make_cloud(cameras, tracks=False)
    turned = type(cloud)(-cloud.xyz, cloud.rgb, cloud.error, None)
    write_colmap(folder, [f"image{index}.png" for index in range(5)], cameras, turned)
    with pytest.raises(InputError, match=r"sparse/0: found 0% of the points inside"):
        load_scene(folder)


def test_images_of_another_number_shape_or_width(folder, write_images):
    with pytest.raises(InputError, match="nothing is enlarged"):
        load_scene(folder, width=97)
    with pytest.raises(InputError, match="image0.png: found an image 12 pixels wide"):
        load_scene(folder, width=13, images="images_8")
    write_images(folder / "images_8", ["image2.png"], (12, 10))
    with pytest.raises(InputError, match=r"image2.png: found 12x10 pixels, expected the shape of its camera, 96x72"):
        load_scene(folder)
    (folder / "images_8" / "image3.png").unlink()
    with pytest.raises(InputError, match=r"images_8: found 4 images, expected the 5 that .*poses_bounds.npy"):
        load_scene(folder)


def _save(array):
    return lambda file: np.save(file, array)


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        (_save(np.zeros((5, 15))), r"shape \(5, 15\)"),
        (_save(np.zeros(17)), r"shape \(17,\)"),
        (_save(np.zeros((5, 17), int)), "int64"),
        (_save(np.full((5, 17), np.nan)), "height nan"),
        (_save(np.zeros((5, 17))), "height 0.0"),
        (_save(np.tile(np.r_[np.zeros(4), 72.5, np.zeros(4), 96, np.zeros(4), 50, 1, 9], (5, 1))), "72.5"),
        (_save(np.tile(np.r_[np.zeros(4), 72, np.zeros(4), 96, np.zeros(4), 50, 1, 9], (5, 1))), "no rotation"),
        (_save(np.tile(np.r_[np.full(4, np.inf), 72, np.zeros(4), 96, np.zeros(4), 50, 1, 9], (5, 1))), "NaN"),
        (lambda file: file.write_bytes(file.read_bytes()[:300]), "no readable array"),
        (lambda file: file.write_bytes(b""), "no readable array"),
        (lambda file: file.write_text("a b c"), "no readable array"),
        (lambda file: np.savez(file.open("wb"), a=np.zeros(3)), "several arrays"),
    ],
)
def test_damaged_poses_are_named(folder, damage, found):
    damage(folder / "poses_bounds.npy")
    with pytest.raises(InputError, match=found) as caught:
        load_scene(folder)
    assert "poses_bounds.npy" in str(caught.value) and "\n" not in str(caught.value)


def test_layout_that_is_not_there(tmp_path, write_images):
    write_images(tmp_path / "images", ["a.png"])
    with pytest.raises(InputError, match=r"poses_bounds.npy: found no such file"):
        load_scene(tmp_path, layout="llff")
