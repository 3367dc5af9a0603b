"""EXIF from image files, from a table beside them and from exif.json, as every reader puts it into a view."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from tolerances import EXIF_RATIONAL

from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif, write_exif
from dofbench.scenes import export, load_scene
from dofbench.scenes.readers.exif_files import exif_by_file, exif_of_image, read_exif_csv

TAGS = {
    "FNumber": 6.3,
    "ExposureTime": 0.0125,
    "Exif:FocalLength": 55.0,
    "Exif:FocalLengthIn35mmFilm": 82,
    "Exif:SubjectDistance": 1.25,
    "Exif:PhotographicSensitivity": 6400,
    "Exif:DateTimeOriginal": "2021:03:04 10:48:15",
    "Make": "SONY",
    "Model": "ILCE-7M2",
    "Exif:LensModel": "FE 55mm F1.8 ZA",
}
RECORD = Exif(6.3, 55.0, 82.0, 1.25, 0.0125, 6400.0, "2021-03-04 10:48:15", "SONY ILCE-7M2", "FE 55mm F1.8 ZA")


def write_photograph(path, tags):
    """A grey picture with EXIF."""
    spec = oiio.ImageSpec(48, 36, 3, "uint8")
    for name, value in tags.items():
        spec.attribute(name, value)
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(np.full((36, 48, 3), 128, np.uint8)) and output.close()
    return path


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_what_the_camera_wrote_down_is_read(tmp_path, suffix):
    found = exif_of_image(write_photograph(tmp_path / f"a.{suffix}", TAGS))
    for name, value in RECORD.as_data().items():
        if suffix == "tif" and name == "iso":
            continue  # the test's writer leaves it out of a TIFF
        got = getattr(found, name)
        assert got == pytest.approx(value, rel=EXIF_RATIONAL) if isinstance(value, float) else got == value, name


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"FNumber": 0.0, "ExposureTime": 0.0},
        {"Exif:DateTimeOriginal": "    "},
        {"Exif:DateTimeOriginal": "0000:00:00 00:00:00"},
    ],
)
def test_what_is_missing_or_impossible_is_none(tmp_path, tags):
    file = write_photograph(tmp_path / "a.jpg", tags)
    assert exif_of_image(file) == Exif()
    assert exif_by_file(tmp_path, {"a": file}) == {}


def test_the_maker_stands_once_in_the_name_of_the_camera(tmp_path):
    file = write_photograph(tmp_path / "a.jpg", {"Make": "Canon", "Model": "Canon EOS 5D"})
    assert exif_of_image(file).camera == "Canon EOS 5D"


def test_the_table_comes_before_the_file_and_exif_json_before_both(tmp_path):
    files = {name: write_photograph(tmp_path / f"images/{name}.jpg", TAGS) for name in "abc"}
    (tmp_path / "exif.csv").write_text(
        "name,f_number,focal_length_mm,exposure_s,iso,time\n"
        "a.jpg,14.0,55.0,0.0166,6400,2021:03:04 10:48:15\nb.png,2,,,,\n"
    )
    write_exif(tmp_path, {"b": Exif(f_number=5.0)})
    found = exif_by_file(tmp_path, files)
    assert found["a"] == Exif(14.0, 55.0, None, None, 0.0166, 6400.0, "2021-03-04 10:48:15")
    assert found["b"] == Exif(f_number=5.0)
    assert found["c"].f_number == pytest.approx(6.3, rel=EXIF_RATIONAL)
    (tmp_path / "exif.json").unlink()
    assert exif_by_file(tmp_path, files)["b"] == Exif(f_number=2.0)  # by the name without suffix


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("file,f_number\na.jpg,2\n", "columns file, f_number"),
        ("name,iso\na.jpg,fast\n", "line 2: iso 'fast'"),
        ("name,iso\na.jpg,1\na.jpg,2\n", "a.jpg a second time in line 3"),
        ("name,iso\na.jpg,-1\n", "line 2: iso"),
    ],
)
def test_a_damaged_table_is_said_to_be(tmp_path, text, said):
    (tmp_path / "exif.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_exif_csv(tmp_path / "exif.csv")


@pytest.mark.parametrize("layout", ["colmap", "llff", "nerfstudio"])
def test_every_reader_fills_it(tmp_path, make_cameras, make_cloud, layout):
    cameras, names = make_cameras(3), ["a.png", "b.png", "c.png"]
    for name in names:
        write_photograph(tmp_path / "images" / name, TAGS if name != "c.png" else {})
    if layout == "llff":
        export.write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (3, 1)))
    elif layout == "nerfstudio":
        export.write_transforms(tmp_path / "transforms.json", [f"images/{name}" for name in names], cameras)
    else:
        export.write_colmap(tmp_path, names, cameras, make_cloud(cameras))
    scene = load_scene(tmp_path)
    assert scene.layout == layout
    assert [view.exif is not None for view in scene.views] == [True, True, False]
    training = {view.name: view.exif for view in scene.training_set().views}
    assert "a" not in training and training["b"].camera == "SONY ILCE-7M2" and training["c"] is None


def table(root, *lines):
    (root / "exif.csv").write_text("\n".join(["name,f_number", *lines]) + "\n")


@pytest.fixture
def two_folders(tmp_path):
    """Photographs of equal names in two folders."""
    names = [f"{side}/{name}" for side in ("left", "right") for name in "ab"]
    return {name: write_photograph(tmp_path / f"images/{name}.jpg", {}) for name in names}


@pytest.mark.parametrize("prefix", ["", "images/", "images_4/../images/"])
def test_whole_paths_tell_equal_names_apart(tmp_path, two_folders, prefix):
    lines = [f"{prefix}{name}.jpg,{2 + index}" for index, name in enumerate(two_folders)]
    table(tmp_path, *lines)
    found = exif_by_file(tmp_path, two_folders)
    if ".." in prefix:
        assert not found  # no path of a photograph
    else:
        assert [found[name].f_number for name in two_folders] == [2, 3, 4, 5]


def test_a_bare_name_that_two_photographs_have_is_refused(tmp_path, two_folders):
    table(tmp_path, "a.jpg,2")
    with pytest.raises(InputError, match=r"a\.jpg, which may be images/left/a\.jpg, images/right/a\.jpg"):
        exif_by_file(tmp_path, two_folders)
    left = {name: file for name, file in two_folders.items() if name.startswith("left")}
    assert exif_by_file(tmp_path, left)["left/a"].f_number == 2


def test_a_folders_own_table_is_about_that_folder(tmp_path, two_folders):
    table(tmp_path / "images/left", "a.jpg,2")
    table(tmp_path / "images/right", "a.jpg,4", "b.png,8")
    found = exif_by_file(tmp_path, two_folders)
    assert {name: record.f_number for name, record in found.items()} == {"left/a": 2, "right/a": 4, "right/b": 8}


def test_smaller_copies_have_the_lines_of_the_photographs(tmp_path):
    files = {name: write_photograph(tmp_path / f"images_8/{name}.png", {}) for name in ("a", "b", "a.b")}
    table(tmp_path, "images/a.JPG,2", "b.jpg,4", "a.b.jpg,8", "other/c.jpg,3")
    found = exif_by_file(tmp_path, files)
    assert {name: record.f_number for name, record in found.items()} == {"a": 2, "b": 4, "a.b": 8}


def test_lines_that_differ_about_one_photograph_are_refused(tmp_path):
    files = {"a": write_photograph(tmp_path / "images/a.png", {})}
    table(tmp_path, "a.jpg,2", "a.dng,4")
    with pytest.raises(InputError, match=r"a\.jpg and a\.dng for images/a\.png"):
        exif_by_file(tmp_path, files)
    table(
        tmp_path, "a.jpg,2", "a.dng,2", "a.PNG,4"
    )  # the same name, the suffix's case aside, is surer than another one
    assert exif_by_file(tmp_path, files)["a"].f_number == 4
