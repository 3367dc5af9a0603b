"""DoF-NeRF's layout: f11, f4_bak and f4_obj in images and images_8, one LLFF pose a triplet."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from tolerances import FLOAT32_VALUE, LEVEL_8BIT, POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.core.images import write_png
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds

COUNT, SIZE, SMALL = 20, (96, 72), (12, 9)
# How bright each stack's images are, so that one can tell what was read.
GREY = {"f11": 0.2, "f4_bak": 0.5, "f4_obj": 0.8}
STEMS = {"f11": "DSC_1", "f4_bak": "DSC_2", "f4_obj": "DSC_3"}


def file_name(stack, index):
    return f"{STEMS[stack]}{index:03d}.png"


@pytest.fixture
def folder(tmp_path, make_cameras, make_cloud):
    """20 triplets at 96x72 and 12x9; each photograph of a triplet has a number of its own."""
    root = tmp_path / "plant"
    cameras = make_cameras(COUNT, size=SIZE)
    for images, (width, height) in (("images", SIZE), ("images_8", SMALL)):
        for stack, grey in GREY.items():
            for index in range(COUNT):
                image = np.full((height, width, 3), grey + 0.005 * index, np.float32)
                write_png(root / images / stack / file_name(stack, index), image)
    write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (COUNT, 1)))
    write_colmap(root, [file_name("f11", index) for index in range(COUNT)], cameras, make_cloud(cameras))
    return root


def expected_stack(index, hold):
    """The authors' runner: test views are arange(N)[::hold] + 1; odd training views bak, even ones obj."""
    if index in [start + 1 for start in range(0, COUNT, hold)]:
        return "f11"
    return "f4_bak" if index % 2 else "f4_obj"


@pytest.mark.parametrize("hold", [None, 7, 3, 19])
def test_every_view_is_the_photograph_of_its_role(folder, make_cameras, hold):
    scene = load_scene(folder, hold=hold)
    assert (scene.layout, scene.photographs, len(scene.views)) == ("dofnerf", "shallow", COUNT)
    for index, (view, camera) in enumerate(zip(scene.views, make_cameras(COUNT, size=SIZE), strict=True)):
        stack = expected_stack(index, hold or 9)
        assert view.split == ("test" if stack == "f11" else "train")
        assert view.photograph == ("all-in-focus" if stack == "f11" else "shallow")
        assert view.name == Path(file_name("f11", index)).stem, "one name, whichever photograph"
        assert view.source == folder / "images_8" / stack / file_name(stack, index)
        np.testing.assert_allclose(view.image(), GREY[stack] + 0.005 * index, atol=LEVEL_8BIT / 2 + FLOAT32_VALUE)
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)


def test_the_marker_and_a_wrong_hold(folder):
    (folder / "hold=5").touch()
    views = load_scene(folder).views
    assert [index for index, view in enumerate(views) if view.split == "test"] == [1, 6, 11, 16]
    with pytest.raises(InputError, match="hold 1 for 20 views"):
        load_scene(folder, hold=1)


def test_tracks_and_training_set(folder, make_cameras, make_cloud):
    scene = load_scene(folder)
    cloud = make_cloud(make_cameras(COUNT, size=SIZE))
    assert all(np.array_equal(a, b) for a, b in zip(scene.points.views, cloud.views, strict=True))
    training = scene.training_set()
    assert len(training.views) == COUNT - 3
    assert all(view.image.mean() > 0.45 for view in training.views), "none of them is sharp"


def test_sizes_and_a_shallow_stack_alone(folder):
    assert load_scene(folder, width=12).views[0].source.parent.parent.name == "images_8"
    scene = load_scene(folder, width=40)
    assert scene.views[0].source.parent.parent.name == "images" and scene.views[0].camera.width == 40
    scene = load_scene(folder, images="f4_bak")
    assert {view.photograph for view in scene.views} == {"shallow"}, "those to test with too"
    assert {view.source.parent.name for view in scene.views} == {"f4_bak"}


@pytest.mark.parametrize(("images", "width", "size"), [("f11", None, 12), ("f11", 50, 50), ("images/f11", None, 96)])
def test_the_sharp_photographs_alone_are_an_all_in_focus_scene(folder, images, width, size):
    scene = load_scene(folder, images=images, width=width)
    assert (scene.photographs, scene.views[0].camera.width) == ("all-in-focus", size)
    assert {view.source.parent.name for view in scene.views} == {"f11"}
    assert [index for index, view in enumerate(scene.views) if view.split == "test"] == [1, 10, 19]


# ---- what is wrong is named ----


def test_a_photograph_that_is_missing(folder):
    (folder / "images_8" / "f4_obj" / file_name("f4_obj", 3)).unlink()
    with pytest.raises(InputError, match=r"f4_obj: found 19 images, expected the 20 that .*poses_bounds.npy"):
        load_scene(folder)


def test_a_stack_that_is_missing(folder):
    shutil.rmtree(folder / "images_8" / "f4_bak")
    with pytest.raises(InputError, match=r"images_8/f4_bak: found no images, expected photographs"):
        load_scene(folder)
    shutil.rmtree(folder / "images" / "f4_bak")
    # Without any triplet it is no longer this layout: LLFF's, with too many images.
    with pytest.raises(InputError, match="found 40 images, expected the 20"):
        load_scene(folder)
