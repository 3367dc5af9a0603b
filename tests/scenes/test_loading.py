"""What all layouts share: detection, split, sizes, lazy images."""

import pickle

import numpy as np
import pytest
from called import imported_by
from tolerances import FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, resize, write_png
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms

# Those that one folder can be in at once. The others have files of their own.
LAYOUTS = ("nerfstudio", "llff", "colmap")
COUNT = 20
NAMES = [f"{index:02d}.png" for index in range(COUNT)]


@pytest.fixture
def folder(tmp_path, make_cameras, write_images):
    """A folder in all three layouts at once."""
    cameras = make_cameras(COUNT)
    write_images(tmp_path / "images", NAMES)
    write_colmap(tmp_path, NAMES, cameras, None)
    write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.ones((COUNT, 2)))
    write_transforms(tmp_path / "transforms.json", [f"images/{name}" for name in NAMES], cameras)
    return tmp_path


def held_out(scene):
    return [index for index, view in enumerate(scene.views) if view.split == "test"]


def test_detection_order(folder):
    assert load_scene(folder).layout == "nerfstudio"
    (folder / "transforms.json").unlink()
    assert load_scene(folder).layout == "llff"
    (folder / "poses_bounds.npy").unlink()
    assert load_scene(folder).layout == "colmap"
    (folder / "sparse" / "0" / "points3D.bin").unlink()
    with pytest.raises(InputError) as caught:
        load_scene(folder)
    message = str(caught.value)
    assert message.startswith(f"{folder}: found images, sparse, expected transforms.json (nerfstudio)")
    assert "poses_bounds.npy (llff)" in message and "sparse/0" in message


def test_where_a_scene_is_from_and_whether_it_travels(folder):
    for layout in LAYOUTS:
        scene = load_scene(folder, layout=layout)
        assert (scene.name, scene.root, scene.layout) == (folder.name, folder, layout)
        assert [view.source for view in scene.views] == [folder / "images" / name for name in NAMES]
    view = pickle.loads(pickle.dumps(load_scene(folder).views[2]))
    assert view.image().shape == (36, 48, 3)


def test_hold(folder):
    assert held_out(load_scene(folder)) == [0, 8, 16]
    (folder / "hold=6").touch()
    assert held_out(load_scene(folder)) == [0, 6, 12, 18]
    assert held_out(load_scene(folder, hold=9)) == [0, 9, 18]
    for hold in (0, 1, -2):
        with pytest.raises(InputError, match=f"hold {hold}"):
            load_scene(folder, hold=hold)
    (folder / "hold=6").rename(folder / "hold=0")
    with pytest.raises(InputError, match="hold 0"):
        load_scene(folder)


def test_one_view_cannot_be_split(tmp_path, make_cameras, write_images):
    write_images(tmp_path / "images", ["a.png"])
    write_colmap(tmp_path, ["a.png"], make_cameras(1), None)
    with pytest.raises(InputError, match="hold 8 for 1 view"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("options", "found"), [({"layout": "blender"}, "blender"), ({"width": 0}, "found 0"), ({"width": -3}, "found -3")]
)
def test_wrong_options(folder, options, found):
    with pytest.raises(InputError, match=found):
        load_scene(folder, **options)


def test_no_folder(tmp_path):
    with pytest.raises(InputError, match="nowhere: found no such folder"):
        load_scene(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file: found no such folder"):
        load_scene(tmp_path / "file")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_image_at_its_own_size_is_the_file_and_smaller_ones_are_averages(folder, layout):
    image = np.random.default_rng(0).random((36, 48, 3)).astype(np.float32)
    write_png(folder / "images" / "03.png", image)
    stored = read_image(folder / "images" / "03.png")
    assert np.array_equal(load_scene(folder, layout=layout).views[3].image(), stored)
    half = load_scene(folder, layout=layout, width=24).views[3].image()
    np.testing.assert_allclose(half, stored.reshape(18, 2, 24, 2, 3).mean(axis=(1, 3)), atol=FLOAT32_VALUE)
    odd = load_scene(folder, layout=layout, width=31).views[3]
    assert (odd.camera.width, odd.camera.height) == (31, 23)  # 23.25 rounded
    assert np.array_equal(odd.image(), resize(stored, 31, 23))
    # Each axis by its own factor, so that a point keeps its place in the image.
    assert odd.camera.cy == pytest.approx(11.5) and odd.camera.fy == pytest.approx(52.8 * 23 / 36)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_damaged_images(folder, layout):
    file = folder / "images" / "05.png"
    whole = file.read_bytes()
    file.write_bytes(whole[:-20])
    view = load_scene(folder, layout=layout).views[5]  # the header is there
    with pytest.raises(InputError, match="05.png: found no readable image") as caught:
        view.image()
    assert "\n" not in str(caught.value)
    file.write_bytes(b"no image")
    with pytest.raises(InputError, match="05.png: found no readable image"):
        load_scene(folder, layout=layout)


def test_an_image_that_changed_since_loading(folder, write_images):
    view = load_scene(folder).views[0]
    write_images(folder / "images", ["00.png"], (24, 18))
    with pytest.raises(InputError, match="found 24x18 pixels, expected 48x36"):
        view.image()


def test_importing_is_light():
    heavy = {"torch", "numba", "cv2", "OpenImageIO", "pycolmap", "scipy", "matplotlib"}
    assert not heavy & imported_by("import dofbench.scenes")


def test_masks_beside_photographs_are_no_photographs(tmp_path, write_images):
    write_images(tmp_path, [f"{index}.png" for index in range(4)])
    write_images(tmp_path / "masks", [f"{index}.png" for index in range(4)])
    with pytest.raises(InputError, match="found 4 photographs without poses.*4 in masks/"):
        load_scene(tmp_path)
