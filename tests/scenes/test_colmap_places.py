"""Where COLMAP models are found, which of several is read, and what is said of what isn't used."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from tolerances import POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms

COUNT = 5
NAMES = [f"{index}.png" for index in range(COUNT)]


@pytest.fixture
def cameras(make_cameras):
    return make_cameras(COUNT)


@pytest.fixture
def model(tmp_path, cameras, make_cloud):
    """A model of five images, by itself."""
    write_colmap(tmp_path / "model", NAMES, cameras, make_cloud(cameras))
    return tmp_path / "model/sparse/0"


@pytest.fixture
def root(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    return folder


def put(model, place, images=range(COUNT), *, text=False):
    """Write the model, of these images alone, to a place."""
    reconstruction = pycolmap.Reconstruction(str(model))
    for image in list(reconstruction.images.values()):
        if int(Path(image.name).stem) not in images:
            reconstruction.deregister_frame(image.frame_id)
    place.mkdir(parents=True, exist_ok=True)
    reconstruction.write_text(str(place)) if text else reconstruction.write_binary(str(place))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("place", "images"),
    [
        ("sparse/0", "images"),
        ("sparse", "images"),
        ("colmap/sparse/0", "images"),
        ("colmap/sparse/0", "colmap/images"),
        ("dense/0/sparse", "dense/0/images"),
        ("dense/sparse/0", "dense/images"),
        ("undistorted/sparse", "undistorted/images"),
        ("undistorted/0/sparse", "undistorted/0/images"),
        ("undistort/sparse/0", "undistort/images"),
        ("mvs/sparse", "mvs/images"),
        ("dense/sparse", "dense/images"),
        ("distorted/sparse/0", "input"),
        ("colmap_sparse/0", "images"),
        ("colmap_text", "images"),
    ],
)
def test_places(model, root, cameras, write_images, place, images, text):
    put(model, root / place, text=text)
    write_images(root / images, NAMES)
    for folder in (root, root / place):
        scene = load_scene(folder)
        assert [view.source for view in scene.views] == [root / images / name for name in NAMES]
        assert scene.points is not None and not scene.notes
        for view, camera in zip(scene.views, cameras, strict=True):
            np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)


@pytest.mark.parametrize("text", [False, True])
def test_the_largest_model_is_read(model, root, write_images, text):
    write_images(root / "images", NAMES)
    for number, images in enumerate([(0, 1), (2, 3, 4), (1,)]):
        put(model, root / "sparse" / str(number), images, text=text)
    scene = load_scene(root)
    assert [view.name for view in scene.views] == ["2", "3", "4"]
    said = " ".join(scene.notes)
    assert "sparse/1 with 3 images is read" in said and "sparse/0 has 2" in said
    assert "5 images in images, 3 with a pose in sparse/1: 2 not used (0.png, 1.png)" in said
    with pytest.raises(InputError, match="a model of 2 images"):
        load_scene(root / "sparse/0")
    assert len(load_scene(root / "sparse/1").views) == 3


def test_a_text_model_of_other_images_next_to_the_binary_one_is_named(model, root, write_images):
    write_images(root / "images", NAMES)
    put(model, root / "sparse/0", text=True)
    put(model, root / "sparse/0")
    assert not load_scene(root).notes
    put(model, root / "sparse/0", (0, 1, 2), text=True)
    scene = load_scene(root)
    assert len(scene.views) == 5 and any("3 in images.txt" in note for note in scene.notes)


@pytest.mark.parametrize("spelled", ["images\\{}", "images/{}", ".\\images\\{}"])
def test_names_as_windows_and_other_programs_write_them(root, cameras, write_images, spelled):
    names = [f"left/{name}" for name in NAMES]
    write_images(root / "images", names)
    written = [spelled.format(name.replace("/", "\\") if "\\" in spelled else name) for name in names]
    write_colmap(root, written, cameras, None)
    assert [view.source for view in load_scene(root).views] == [root / "images" / name for name in names]


def test_suffixes_in_another_case(root, cameras, write_images):
    write_images(root / "images", [name.replace("png", "PNG") for name in NAMES])
    write_colmap(root, NAMES, cameras, None)
    scene = load_scene(root)
    assert [view.source.name for view in scene.views] == [f"{index}.PNG" for index in range(COUNT)]
    assert not scene.notes


def test_a_model_without_its_images_gives_way_to_one_with(model, root, write_images):
    put(model, root / "sparse/0")
    put(model, root / "dense/0/sparse")
    write_images(root / "dense/0/images", NAMES)
    assert load_scene(root).views[0].source.parent == root / "dense/0/images"


def test_images_that_were_deleted(model, root, make_cloud, write_images):
    put(model, root / "sparse/0")
    write_images(root / "images", [NAMES[index] for index in (0, 2, 3)])
    with pytest.raises(InputError, match=r"no image for 1\.png, 4\.png.*--skip-missing"):
        load_scene(root)
    everything = load_scene(_with_all(root, write_images))
    for name in (NAMES[1], NAMES[4]):
        (root / "images" / name).unlink()
    scene = load_scene(root, skip_missing=True)
    assert [view.name for view in scene.views] == ["0", "2", "3"]
    assert any("1.png, 4.png" in note for note in scene.notes)
    expected = everything.points.seen_by([0, 2, 3])
    lost = len(everything.points) - len(expected)
    assert bool(lost) == any(f"{lost} that no remaining view saw" in note for note in scene.notes)
    np.testing.assert_array_equal(scene.points.xyz, expected.xyz)
    for ours, theirs in zip(scene.points.views, expected.views, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def _with_all(root, write_images):
    write_images(root / "images", NAMES)
    return root


def test_deleted_images_of_transforms_json(model, root, cameras, write_images):
    put(model, root / "sparse/0")
    write_transforms(root / "transforms.json", [f"images/{name}" for name in NAMES], cameras)
    write_images(root / "images", [NAMES[index] for index in (0, 2, 3)])
    (root / "test.txt").write_text("1.png\n2.png\n")
    with pytest.raises(InputError, match=r"no image for images/1\.png, images/4\.png.*--skip-missing"):
        load_scene(root)
    scene = load_scene(root, skip_missing=True)
    assert scene.layout == "nerfstudio" and [view.name for view in scene.views] == ["0", "2", "3"]
    assert [view.name for view in scene.test_views()] == ["2"]
    assert any("images/1.png, images/4.png" in note for note in scene.notes)
    shutil.rmtree(root / "images")
    with pytest.raises(InputError):
        load_scene(root, skip_missing=True)


def test_transforms_json_takes_points_from_any_place(model, root, cameras, write_images):
    put(model, root / "colmap/sparse/0")
    write_transforms(root / "transforms.json", [f"images/{name}" for name in NAMES], cameras)
    write_images(root / "images", NAMES)
    points = load_scene(root).points
    assert points is not None and points.views is not None


class TestRowsOfAPartOfTheImages:
    """LLFF's rows are of the images that structure from motion registered, in the order of their names."""

    @pytest.fixture
    def folder(self, model, root, cameras, write_images):
        write_images(root / "images", NAMES)
        rows = [cameras[index] for index in (0, 2, 4)]
        write_poses_bounds(root / "poses_bounds.npy", rows, np.tile([1.0, 9.0], (3, 1)))
        return root

    def test_the_model_says_which(self, folder, model, cameras):
        put(model, folder / "sparse/0", (0, 2, 4))
        scene = load_scene(folder)
        assert scene.layout == "llff" and [view.name for view in scene.views] == ["0", "2", "4"]
        for view in scene.views:
            given = cameras[int(view.name)].world_to_camera
            np.testing.assert_allclose(view.camera.world_to_camera, given, atol=POSE_ROUND_TRIP)
        assert scene.points is not None and scene.points.views is not None
        assert any("3 poses for 5 images" in note for note in scene.notes)
        assert any("2 not used (1.png, 3.png)" in note for note in scene.notes)

    @pytest.mark.parametrize("images", [(0, 1, 4), (0, 1, 2, 3, 4)])
    def test_another_model_is_named_as_the_way_out(self, folder, model, images):
        put(model, folder / "sparse/0", images)
        with pytest.raises(InputError, match="--layout colmap"):
            load_scene(folder)
        assert len(load_scene(folder, layout="colmap").views) == len(images)

    def test_without_a_model_it_is_refused(self, folder):
        with pytest.raises(InputError, match="found 5 images, expected the 3 that"):
            load_scene(folder)

    def test_rows_of_deleted_images_are_skipped_on_request(self, folder, model, cameras):
        put(model, folder / "sparse/0", (0, 2, 4))
        (folder / "images/2.png").unlink()
        with pytest.raises(InputError, match="--skip-missing"):
            load_scene(folder)
        scene = load_scene(folder, skip_missing=True)
        assert [view.name for view in scene.views] == ["0", "4"]
        (folder / "images/1.png").unlink()  # as many images as rows, but not the same
        with pytest.raises(InputError, match="--skip-missing"):
            load_scene(folder)
        assert [view.name for view in load_scene(folder, skip_missing=True).views] == ["0", "4"]
        given = cameras[4].world_to_camera
        np.testing.assert_allclose(scene.views[1].camera.world_to_camera, given, atol=POSE_ROUND_TRIP)


def test_a_scene_farther_down_is_named(model, root, write_images):
    put(model, root / "work/step3/sparse/0")
    write_images(root / "work/step3/images", NAMES)
    with pytest.raises(InputError, match="the folder of one scene, as .*/work/step3"):
        load_scene(root)
    assert load_scene(root / "work/step3").layout == "colmap"


def test_lists_that_a_layout_passes_over_are_named(model, root, cameras, write_images):
    put(model, root / "sparse/0")
    write_images(root / "images", NAMES)
    paths = [f"images/{name}" for name in NAMES]
    write_transforms(root / "transforms.json", paths, cameras)
    assert not load_scene(root, layout="colmap").notes
    splits: list = ["train", "test", "train", "train", "train"]
    write_transforms(root / "transforms.json", paths, cameras, splits=splits)
    assert any("transforms.json are not used" in note for note in load_scene(root, layout="colmap").notes)


class TestRowsInAnotherOrder:
    """As many rows as images and as the model has, of the same cameras or others."""

    @pytest.fixture
    def spread(self, make_cameras):
        return make_cameras(10)

    def scene(self, root, ours, theirs, write_images):
        names = [f"{index}.png" for index in range(10)]
        write_images(root / "images", names)
        write_poses_bounds(root / "poses_bounds.npy", ours, np.tile([1.0, 9.0], (10, 1)))
        write_colmap(root, names, theirs, None)
        return root

    @pytest.mark.parametrize("order", [[1, 0, *range(2, 10)], [*range(1, 10), 0], [*range(9, -1, -1)]])
    def test_in_one_frame(self, root, spread, write_images, order):
        folder = self.scene(root, [spread[index] for index in order], spread, write_images)
        with pytest.raises(InputError, match=r"rows of other images.*--layout colmap"):
            load_scene(folder, layout="llff")
        assert load_scene(folder, layout="colmap").views

    def test_up_to_a_similarity(self, root, spread, write_images):
        moved = [_by_a_similarity(camera) for camera in spread]
        folder = self.scene(root, spread, moved, write_images)
        assert not load_scene(folder, layout="llff").notes
        folder = self.scene(root, spread[1:] + spread[:1], moved, write_images)
        with pytest.raises(InputError, match="elsewhere than in"):
            load_scene(folder, layout="llff")
        folder = self.scene(root, [spread[1], spread[0], *spread[2:]], moved, write_images)
        assert any(note.startswith("0.png, 1.png elsewhere") for note in load_scene(folder, layout="llff").notes)


def _by_a_similarity(camera):
    """The camera in a frame that is turned, 3 times as large and moved."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3] = camera.world_to_camera[:3, :3] @ turn.T
    pose[:3, 3] = -pose[:3, :3] @ (3 * turn @ camera.centre + (5.0, 1.0, 2.0))
    return replace(camera, world_to_camera=pose)
