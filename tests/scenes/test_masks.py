"""Masks of a scene: where they are found, how they are resampled, and that nothing under them is read."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from made_up import frontal
from PIL import Image

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, to_8bit, write_png
from dofbench.core.masks import filled, read_mask, shrunk_mask, write_mask
from dofbench.scenes import export, load_scene
from dofbench.scenes.on_disk import undistort_mask
from dofbench.scenes.undistort import Intrinsics, undistort_image, undistorted

WIDTH, HEIGHT, COUNT = 40, 30, 4


def picture(index):
    return np.random.default_rng(index).uniform(0.2, 0.8, (HEIGHT, WIDTH, 3)).astype(np.float32)


def mask_of(index):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[4:20, 3 + 5 * index : 15 + 5 * index] = False
    return mask


def scene_in(root, kind, junk=0):
    """A scene with masks of one kind in every view but the last, and noise under them."""
    names = [f"v{index}.png" for index in range(COUNT)]
    cameras = [frontal(WIDTH, HEIGHT, 40.0, (0.1 * index, 0.0, 0.0)) for index in range(COUNT)]
    for index, name in enumerate(names):
        noise = np.random.default_rng(100 + junk + index).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
        masked = index < COUNT - 1
        image = np.where(mask_of(index)[..., None], picture(index), noise) if masked else picture(index)
        if kind == "alpha" and masked:
            (root / "images").mkdir(parents=True, exist_ok=True)
            values = np.dstack([image, mask_of(index)])
            Image.fromarray((values * 255 + 0.5).astype(np.uint8)).save(root / "images" / name)
            continue
        write_png(root / "images" / name, image)
        place = {"mask_path": f"hidden/{index}.png", "colmap": f"masks/{name}.png", "stem": f"masks/v{index}.PNG"}
        if masked and kind in place:
            write_mask(root / place[kind], mask_of(index))
    extra = [{"mask_path": f"hidden/{index}.png"} if kind == "mask_path" and index < COUNT - 1 else {} for index in
             range(COUNT)]  # fmt: skip
    files = [f"images/{name}" for name in names]
    if kind == "mask_path":
        export.write_transforms(root / "transforms.json", files, cameras, extra=extra)
    else:
        export.write_colmap(root, names, cameras, None)
    return root


@pytest.mark.parametrize("kind", ["mask_path", "colmap", "stem", "alpha"])
def test_masks_are_found_and_said(tmp_path, kind):
    scene = load_scene(scene_in(tmp_path / "scene", kind))
    for index, view in enumerate(scene.views[:-1]):
        assert np.array_equal(view.mask(), mask_of(index))
        valid = mask_of(index)
        assert np.array_equal(to_8bit(view.image())[valid], to_8bit(picture(index))[valid])
    assert scene.views[-1].mask is None
    assert any("masks of 3 of 4 views" in note and "unmasked: v3" in note for note in scene.notes)
    assert any("alpha channel of 3 images: taken as a mask" in note for note in scene.notes) is (kind == "alpha")


@pytest.mark.parametrize("kind", ["mask_path", "colmap", "stem", "alpha"])
@pytest.mark.parametrize("width", [None, 17])
def test_nothing_under_a_mask_is_read(tmp_path, kind, width):
    one, two = (load_scene(scene_in(tmp_path / str(junk), kind, junk), width=width) for junk in (0, 50))
    for a, b in zip(one.views, two.views, strict=True):
        assert np.array_equal(a.image(), b.image())


def test_alpha_may_be_a_background(tmp_path):
    scene = load_scene(scene_in(tmp_path, "alpha"), alpha_channel="background")
    assert scene.views[0].mask is None and (scene.views[0].image()[~mask_of(0)] == 0).all()
    assert scene.notes[-1:] == ("alpha channel of 3 images: composited over black",)
    with pytest.raises(InputError, match="alpha_channel"):
        load_scene(tmp_path, alpha_channel="holes")


def test_opaque_alpha_is_no_mask(tmp_path):
    root = scene_in(tmp_path, "none")
    for index in range(COUNT):
        values = np.dstack([picture(index), np.ones((HEIGHT, WIDTH))])
        Image.fromarray((values * 255 + 0.5).astype(np.uint8)).save(root / "images" / f"v{index}.png")
    scene = load_scene(root)
    assert all(view.mask is None for view in scene.views) and not any("alpha" in note for note in scene.notes)


def test_a_mask_of_another_shape_without_a_pixel_or_missing_is_refused(tmp_path):
    root = scene_in(tmp_path, "colmap")
    write_mask(root / "masks" / "v0.png.png", np.zeros((HEIGHT, WIDTH), bool))
    with pytest.raises(InputError, match="without a valid pixel"):
        load_scene(root).training_set() if load_scene(root).views[0].split == "train" else load_scene(root).unmasked()
    write_mask(root / "masks" / "v0.png.png", np.ones((HEIGHT, WIDTH // 2), bool))
    with pytest.raises(InputError, match=r"a mask of 20x30 pixels, expected 40x30"):
        load_scene(root)
    named = scene_in(tmp_path / "named", "mask_path")
    (named / "hidden" / "1.png").unlink()
    with pytest.raises(InputError, match="no such file"):
        load_scene(named)
    content = json.loads((named / "transforms.json").read_text())
    content["frames"][1]["mask_path"] = "../secret.png"
    (named / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="secret"):
        load_scene(named)


def test_whose_mask_a_file_is_must_be_clear(tmp_path):
    root = scene_in(tmp_path, "stem")
    shutil.copy(root / "masks" / "v1.PNG", root / "masks" / "v1.bmp")
    with pytest.raises(InputError, match="one mask of"):
        load_scene(root)


def test_masks_named_after_no_image_are_named(tmp_path):
    root = scene_in(tmp_path, "none")
    write_mask(root / "masks" / "other.png", mask_of(0))
    assert any("none of them named after an image" in note for note in load_scene(root).notes)


@pytest.mark.parametrize("fisheye", [False, True])
def test_an_undistorted_pixel_is_valid_only_if_all_its_samples_are(fisheye):
    lens = Intrinsics(60, 45, 50.0, 50.0, 30.0, 22.5, (0.1, 0.02) if fisheye else (-0.2, 0.05), fisheye)
    mask = np.ones((45, 60), bool)
    mask[10:20, 15:30] = False
    valid = undistort_mask(mask, lens)
    assert valid.shape == (45, 60) and 0 < (~valid).sum() < mask.size / 2
    random = np.random.default_rng(0)
    image = random.uniform(0.1, 0.9, (45, 60, 3)).astype(np.float32)
    image[0, 0], image[0, 1] = 0, 1  # the extremes to which the result is clipped
    other = np.where(mask[..., None], image, random.uniform(0.1, 0.9, image.shape).astype(np.float32))
    changed = (undistort_image(image, lens) != undistort_image(other, lens)).any(axis=2)
    assert changed.any() and not (changed & valid).any()
    assert undistorted(lens).width == 60


def test_a_filled_image_has_the_nearest_valid_pixels():
    image, mask = picture(0), mask_of(0)
    found = filled(image, mask)
    assert np.array_equal(found[mask], image[mask])
    valid = np.argwhere(mask)
    for row, column in np.argwhere(~mask):
        squared = ((valid - (row, column)) ** 2).sum(axis=1)
        near = valid[squared == squared.min()]
        assert any(np.array_equal(found[row, column], image[y, x]) for y, x in near)


def test_a_shrunk_pixel_is_valid_only_if_all_that_it_averages_is():
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[7, 11] = False
    assert np.array_equal(np.argwhere(~shrunk_mask(mask, WIDTH // 2, HEIGHT // 2)), [[3, 5]])


def test_a_jpeg_mask_counts_from_mid_grey_and_others_above_black(tmp_path):
    grey = np.full((16, 16), 3, np.uint8)
    for name, expected in (("a.png", True), ("a.jpg", False)):
        Image.fromarray(grey).save(tmp_path / name)
        assert (read_mask(tmp_path / name) == expected).all()
    assert read_image(tmp_path / "a.png").shape == (16, 16, 3)
