"""Choosing image folders, matching files to names, naming views."""

import pytest

from dofbench.core.errors import InputError
from dofbench.scenes.readers.folders import choose_folder, image_files, listed, marked_hold, match_files, view_names


@pytest.fixture
def pyramid(tmp_path, write_images):
    for factor, size in ((1, (96, 72)), (4, (24, 18)), (8, (12, 9))):
        folder = tmp_path / ("images" if factor == 1 else f"images_{factor}")
        write_images(folder, ["a.png", "b.png"], size)
    (tmp_path / "images_backup").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("width", "habit", "expected"),
    [
        (None, (8, 4, 1), "images_8"),
        (None, (1,), "images"),
        (None, (2,), "images"),
        (12, (1,), "images_8"),
        (13, (8,), "images_4"),
        (24, (8,), "images_4"),
        (25, (8,), "images"),
        (96, (8,), "images"),
    ],
)
def test_smallest_folder_that_is_wide_enough(pyramid, width, habit, expected):
    assert choose_folder(pyramid, width=width, images=None, habit=habit).name == expected


def test_named_missing_and_narrow_folders(pyramid, tmp_path):
    assert choose_folder(pyramid, width=None, images="images_4", habit=(8,)).name == "images_4"
    with pytest.raises(InputError, match=r"images: found images 96 pixels wide, expected at least the 97 asked for"):
        choose_folder(pyramid, width=97, images=None, habit=(8,))
    with pytest.raises(InputError, match="images_2: found no such folder"):
        choose_folder(pyramid, width=None, images="images_2", habit=(8,))
    with pytest.raises(InputError, match="images_backup: found no images"):
        choose_folder(pyramid, width=None, images="images_backup", habit=(8,))
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="found an empty folder, expected a folder images or images_N"):
        choose_folder(empty, width=None, images=None, habit=(8,))


def test_hidden_files_and_other_suffixes_are_no_images(tmp_path, write_images):
    write_images(tmp_path, ["b.png", ".hidden.png", "sub/a.PNG", "sub/.x/c.png"])
    (tmp_path / "notes.txt").write_text("no image")
    assert [path.relative_to(tmp_path).as_posix() for path in image_files(tmp_path)] == ["b.png", "sub/a.PNG"]


def test_files_are_matched_by_name_then_stem_then_order(tmp_path, write_images):
    write_images(tmp_path, ["a.png", "b.png", "c.png"])
    assert [path.name for path in match_files(tmp_path, ["c.png", "a.png"], "model")] == ["c.png", "a.png"]
    assert [path.name for path in match_files(tmp_path, ["c.JPG", "a.JPG"], "model")] == ["c.png", "a.png"]
    renamed = ["IMG_9.JPG", "IMG_7.JPG", "IMG_8.JPG"]
    assert [p.name for p in match_files(tmp_path, renamed, "model", by_order=True)] == ["c.png", "a.png", "b.png"]


@pytest.mark.parametrize(
    ("names", "by_order"),
    [
        (["IMG_9.JPG", "IMG_7.JPG", "IMG_8.JPG"], False),  # order is for LLFF only
        (["a.png", "b.png", "x.png"], True),  # some names fit, so the others are missing, not renumbered
        (["IMG_7.JPG", "IMG_8.JPG"], True),  # another count
    ],
)
def test_unmatched_names_are_an_error(tmp_path, write_images, names, by_order):
    write_images(tmp_path, ["a.png", "b.png", "c.png"])
    with pytest.raises(InputError, match=f"{tmp_path}: found no image for"):
        match_files(tmp_path, names, "model", by_order=by_order)


def test_two_files_for_one_stem_are_an_error(tmp_path, write_images):
    write_images(tmp_path, ["a.png", "a.tif.png"])
    (tmp_path / "a.png").rename(tmp_path / "a.tif")
    (tmp_path / "a.tif.png").rename(tmp_path / "a.bmp")
    with pytest.raises(InputError, match="several images for a.JPG"):
        match_files(tmp_path, ["a.JPG"], "model")


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["images/a.png", "images/b.jpg"], ["a", "b"]),
        (["left/a.png", "right/a.png"], ["left_a", "right_a"]),
        (["x/a.png", "x/a.jpg"], ["x_a_png", "x_a_jpg"]),
        (["a/b_c.png", "a_b/c.png"], ["b_c", "c"]),
        (["a/b/c.png", "a/b_c.png", "a_b/c.png"], ["a_b_c_png_0", "a_b_c_png_1", "a_b_c_png_2"]),
    ],
)
def test_view_names_are_unique(files, names):
    assert view_names(files) == names


def test_hold_marker(tmp_path):
    assert marked_hold(tmp_path) is None
    (tmp_path / "hold=6").touch()
    assert marked_hold(tmp_path) == 6
    # As DoF-Gaussian's instructions write it.
    (tmp_path / "hold=6").rename(tmp_path / "hold = 6")
    assert marked_hold(tmp_path) == 6
    (tmp_path / "hold=7").touch()
    with pytest.raises(InputError, match="2 marker files"):
        marked_hold(tmp_path)


def test_long_lists_are_shortened():
    assert listed(["a", "b"]) == "a, b"
    assert listed("abcdef") == "a, b, c and 3 more"
