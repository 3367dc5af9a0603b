"""Structure from motion takes masks for masks: not for photographs, and nothing from under them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_grey_png, write_png
from dofbench.core.masks import read_mask, write_mask
from dofbench.scenes.reconstruction.features import extract, group_by_camera, read, register_images
from dofbench.scenes.reconstruction.photograph_list import MASKS, find_photographs, prepare

WIDTH, HEIGHT, COUNT = 96, 72, 3


def texture(seed):
    """Smooth noise, which has features everywhere."""
    noise = gaussian_filter(np.random.default_rng(seed).uniform(size=(HEIGHT, WIDTH, 3)), (1.5, 1.5, 0))
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


def mask():
    """The left half is masked."""
    valid = np.ones((HEIGHT, WIDTH), bool)
    valid[:, : WIDTH // 2] = False
    return valid


def grey(path):
    """A map of one channel, of another size than the photographs."""
    write_grey_png(path, np.full((18, 24), 0.5, np.float32))


@pytest.mark.parametrize(
    ("photographs", "others"),
    [
        ("{}.png", ["masks/{}.png", "depth/{}.png", "conf/{}.png"]),
        ("{}.png", ["masks/{}.png.png"]),
        ("rgb/{}.png", ["depth/{}.png", "confidence/{}.png"]),
        ("rgb/{}.png", ["lidar_depth/x{}.png"]),
        ("{}.png", ["{}_mask.png", "{}.depth.png"]),
    ],
)
def test_maps_next_to_photographs_are_none(tmp_path, photographs, others):
    for index in range(COUNT):
        write_png(tmp_path / photographs.format(f"a{index}"), texture(index))
        for place in others:
            file = tmp_path / place.format(f"a{index}")
            write_mask(file, mask()) if "mask" in place else grey(file)
    found = find_photographs(tmp_path, None)
    assert [one.name for one in found.photographs] == ["a0", "a1", "a2"]
    assert any("not taken for photographs" in note for note in found.notes)
    assert all((one.mask is not None) == any("masks/" in place for place in others) for one in found.photographs)


def test_a_folder_of_photographs_may_have_the_name_of_a_kind_of_map(tmp_path):
    for index in range(COUNT):
        write_png(tmp_path / "depth" / f"a{index}.png", texture(index))
    assert len(find_photographs(tmp_path, None).photographs) == COUNT


@pytest.mark.parametrize("kind", ["masks", "alpha"])
def test_no_feature_is_taken_from_under_a_mask(tmp_path, kind):
    from PIL import Image

    source, work = tmp_path / "source", tmp_path / "work"
    source.mkdir()
    for index in range(COUNT):
        if kind == "alpha":
            values = np.dstack([texture(index), mask()])
            Image.fromarray((values * 255).astype(np.uint8)).save(source / f"a{index}.png")
        else:
            write_png(source / f"a{index}.png", texture(index))
            write_mask(source / "masks" / f"a{index}.png", mask())
    found = find_photographs(source, None)
    prepared = prepare(found.photographs, work / "photographs", 1600, lambda done: None)
    assert all(np.array_equal(read_mask(one.mask), mask()) for one in prepared)
    # What is under the mask isn't in the pictures either.
    image, truth = read_image(work / "photographs" / prepared[0].file_name), texture(0)
    assert np.ptp(truth[:, :45], axis=1).max() > 0 == np.ptp(image[:, :45], axis=1).max()
    groups = group_by_camera(prepared, "shared", None)
    register_images(work / "db", work / "photographs", prepared, groups, "SIMPLE_RADIAL")
    options = {"most": 500, "threads": 1, "advance": lambda done: None}
    extract(work / "db", work / "photographs", prepared, masks=work / MASKS, **options)
    for _, keypoints, _ in read(work / "db", prepared):
        assert len(keypoints) > 5 and (keypoints[:, 0] >= WIDTH // 2).all()


def test_a_mask_of_another_shape_and_one_without_a_pixel_are_refused(tmp_path):
    for index in range(COUNT):
        write_png(tmp_path / f"a{index}.png", texture(index))
        write_mask(tmp_path / "masks" / f"a{index}.png", np.ones((HEIGHT, WIDTH - 20), bool))
    photograph = find_photographs(tmp_path, None).photographs[0]
    with pytest.raises(InputError, match=r"a0\.png: found a mask of 76x72"):
        photograph.read()
    write_mask(tmp_path / "masks" / "a0.png", np.zeros((HEIGHT, WIDTH), bool))
    with pytest.raises(InputError, match="without a valid pixel"):
        photograph.read()
