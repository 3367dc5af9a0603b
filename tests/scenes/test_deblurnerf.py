"""Deblur-NeRF's layout: LLFF's poses, a marker hold=N, sharp photographs at 0, N, 2N, ... among blurred ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tolerances import POSE_ROUND_TRIP

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds
from dofbench.scenes.named import resolve

COUNT, SIZE = 13, (96, 72)
# Photographs of a camera, as the real scenes have them, and numbered copies.
NAMES = [f"IMG_{4000 + 3 * index}.JPG" for index in range(COUNT)]
SMALL = [f"IMG_{4000 + 3 * index}.png" for index in range(COUNT)]


@pytest.fixture
def folder(tmp_path, make_cameras, make_cloud, write_images):
    """images (PNG here: nothing depends on it), images_4, poses_bounds.npy, sparse/0, hold=6."""
    root = tmp_path / "defocusseal"
    cameras = make_cameras(COUNT, size=SIZE)
    write_images(root / "images", SMALL, SIZE)
    write_images(root / "images_4", SMALL, (24, 18))
    write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (COUNT, 1)))
    write_colmap(root, NAMES, cameras, make_cloud(cameras))
    (root / "hold=6").touch()
    return root


def test_blurred_views_to_train_on_and_sharp_ones_to_test_with(folder, make_cameras):
    scene = load_scene(folder, layout="deblurnerf")
    assert (scene.layout, scene.photographs) == ("deblurnerf", "shallow")
    assert [view.name for view in scene.test_views()] == [Path(NAMES[index]).stem for index in (0, 6, 12)]
    assert all((view.photograph == "shallow") is (view.split == "train") for view in scene.views)
    assert {(view.camera.width, view.camera.height) for view in scene.views} == {(24, 18)}, "factor 4"
    for index, (view, camera) in enumerate(zip(scene.views, make_cameras(COUNT, size=SIZE), strict=True)):
        assert view.source == folder / "images_4" / SMALL[index]
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)


def test_the_training_set_has_no_test_view_and_no_point_that_only_test_views_saw(folder, make_cameras, make_cloud):
    scene = load_scene(folder, layout="deblurnerf")
    training = scene.training_set()
    names = [view.name for view in training.views]
    assert names == [Path(name).stem for index, name in enumerate(NAMES) if index % 6]
    assert np.array_equal(training.views[0].image, read_image(folder / "images_4" / SMALL[1]))
    cloud = make_cloud(make_cameras(COUNT, size=SIZE))
    seen = [track for track in cloud.views if any(view % 6 for view in track)]
    assert len(training.points) == len(seen)
    for found, given in zip(training.points.views, seen, strict=True):
        assert [names[view] for view in found] == [Path(NAMES[view]).stem for view in given if view % 6]


def textured(file, seed, blur):
    """A random texture in place of an image of that size; blur: standard deviation, px."""
    image = np.random.default_rng(seed).uniform(0, 1, read_image(file).shape)
    image = gaussian_filter(image, (0.6, 0.6, 0))
    write_png(file, np.clip(gaussian_filter(image, (blur, blur, 0)), 0, 1).astype(np.float32))


def blurred(folder, blur):
    """Textures in images/, the i-th blurred by blur(i); the smaller copies are removed."""
    shutil.rmtree(folder / "images_4")
    for index, name in enumerate(sorted(SMALL)):
        textured(folder / "images" / name, index, blur(index))


def test_sharp_views_among_blurred_ones_are_found_by_measuring(folder):
    blurred(folder, lambda index: 1.0 + 0.1 * index if index % 6 else 0.0)
    scene = load_scene(folder)
    assert (scene.layout, scene.photographs) == ("deblurnerf", "shallow")
    assert [view.name for view in scene.test_views()] == [Path(NAMES[index]).stem for index in (0, 6, 12)]
    assert scene.split_by and any("deblurnerf" in note for note in scene.notes)
    with pytest.raises(InputError, match=r"--hold: found 5 in"):
        load_scene(folder, hold=5)
    assert load_scene(folder, hold=6).layout == "deblurnerf"
    # However small the images are read, in which the blur can't be seen.
    assert load_scene(folder, width=12).layout == "deblurnerf"


@pytest.mark.parametrize("blur", [lambda index: 0.0, lambda index: 1.5, lambda index: 0.0 if index % 5 else 1.5])
def test_views_that_are_no_sharper_than_others_need_a_layout(folder, blur):
    blurred(folder, blur)
    with pytest.raises(InputError, match=r"hold=6.*--layout deblurnerf .*--layout llff"):
        load_scene(folder)
    scene = load_scene(folder, layout="llff")
    assert (scene.layout, scene.photographs) == ("llff", "all-in-focus")
    assert load_scene(folder, layout="deblurnerf").photographs == "shallow"


@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_the_marker_in_a_colmap_scene(folder, blur):
    (folder / "poses_bounds.npy").unlink()
    blurred(folder, lambda index: blur if index % 6 else 0.0)
    scene = load_scene(folder)
    assert scene.layout == "colmap" and len(scene.test_views()) == 3
    assert scene.photographs == ("shallow" if blur else "all-in-focus")
    assert any("hold=6" in note for note in scene.notes)
    assert load_scene(folder, layout="colmap").photographs == "all-in-focus"


def test_sizes_and_a_hold_that_is_never_guessed(folder):
    assert resolve(str(folder), None)[0].load().photographs == "shallow"
    assert load_scene(folder, layout="deblurnerf", width=60).views[0].source.parent.name == "images"
    assert load_scene(folder, layout="deblurnerf", images="images").views[0].camera.width == 96
    for path in (folder / "images_4").iterdir():
        path.unlink()
    assert load_scene(folder, layout="deblurnerf").views[0].camera.width == 96
    (folder / "hold=6").unlink()
    with pytest.raises(InputError, match="no marker file hold=N and no hold"):
        load_scene(folder, layout="deblurnerf")
    assert len(load_scene(folder, layout="deblurnerf", hold=5).test_views()) == 3
