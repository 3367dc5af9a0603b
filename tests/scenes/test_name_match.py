"""Names of images: whole paths, then suffixes aside, then ends of paths; never by chance."""

from __future__ import annotations

import pytest

from dofbench.core.errors import InputError
from dofbench.scenes.readers.folders import find_matches, match_files
from dofbench.scenes.readers.name_match import ImageNames, plain_inside, without_suffix


@pytest.mark.parametrize(
    ("images", "name", "partial", "found"),
    [
        (["a.png", "b.png"], "b.png", False, [1]),
        (["a.PNG", "a.jpg"], "a.png", False, [0]),  # upper and lower case of the suffix before another suffix
        (["a.PNG", "a.jpg"], "a.JPG", False, [1]),
        (["a.jpg", "b.jpg"], "a.png", False, [0]),
        (["a.jpg", "b.jpg"], "a", False, [0]),
        (["a.jpg", "a.webp"], "a.png", False, [0, 1]),
        (["a.jpg", "a.webp"], "a", False, [0, 1]),
        (["A.jpg"], "a.jpg", False, []),  # names themselves keep their case
        (["left/a.png", "right/a.png"], "right\\a.png", False, [1]),
        (["left/a.png"], "a.png", False, []),
        (["left/a.png"], "a.png", True, [0]),
        (["left/a.png"], "eft/a.png", True, []),  # whole parts only
        (["left/a.png", "right/a.png"], "a.png", True, [0, 1]),
        (["left/a.png", "a.png"], "a.png", True, [1]),
        (["x/left/a.png", "x/right/a.png"], "right/a.jpg", True, [1]),
        (["frame.001.png", "frame.002.png"], "frame.002", False, [1]),  # .002 is no suffix
        (["a b.png", "a c.png", "a.png"], "a c.png", False, [1]),
        (["a.png"], "./a.png", False, [0]),
        (["a.png"], "b.png", True, []),
    ],
)
def test_the_first_step_that_finds_an_image_decides(images, name, partial, found):
    assert list(ImageNames([(image,) for image in images], partial=partial).find(name).images) == found


def test_surer_names_come_first():
    index = ImageNames([("a.png", "images/a.png"), ("images/a.png", "images/images/a.png")])
    assert index.find("images/a.png").images == (1,)
    assert index.find("a.png").images == (0,)


@pytest.mark.parametrize("suffix", [".png", ".JPG", ".HEIC", ".Tiff"])
def test_suffixes_of_photographs(suffix):
    assert without_suffix(f"a.b{suffix}") == "a.b"
    assert without_suffix("a.0001") == "a.0001"


@pytest.mark.parametrize("name", ["../a.png", "a/../../b.png", "/etc/a.png", "C:\\a.png", "", None, 7, "a\nb.png"])
def test_paths_that_lead_out_are_refused(name):
    with pytest.raises(InputError, match="images.txt"):
        plain_inside(name, "images.txt")


def test_names_with_the_folder_before_them(tmp_path, write_images):
    write_images(tmp_path / "images_4", ["left/a.png", "b.png"])
    found = match_files(tmp_path / "images_4", ["images/left/a.jpg", "images_4\\b.png"], "model")
    assert [file.relative_to(tmp_path).as_posix() for file in found] == ["images_4/left/a.png", "images_4/b.png"]


def test_missing_files_and_files_of_two_names(tmp_path, write_images):
    write_images(tmp_path, ["a.png", "b.png"])
    with pytest.raises(InputError, match=r"a\.png for both a\.png and a\.jpg"):
        match_files(tmp_path, ["a.png", "a.jpg"], "model")
    write_images(tmp_path, ["a.png", "b.png"])
    with pytest.raises(InputError, match=r"no image for c\.png.*--skip-missing reads the other 2"):
        match_files(tmp_path, ["a.png", "c.png", "b.png"], "model")
    assert find_matches(tmp_path, ["a.png", "c.png", "b.JPG"], "model").present() == [0, 2]
