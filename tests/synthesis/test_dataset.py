"""The reader: what a method sees, what the harness sees, and which folders it refuses."""

from __future__ import annotations

import copy
import dataclasses
import functools
import json
import os
import random
import shutil

import numpy as np
import pytest
from relisted import edit_json, relist
from tolerances import FLOAT64_VALUE

from dofbench.core.blur import Blur
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr, read_image
from dofbench.core.lens import Lens
from dofbench.core.progress import Silent
from dofbench.datasets.format.schema import read_manifest
from dofbench.datasets.synthesis import Dataset, builtin_folder, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes import load_scene


@pytest.fixture(scope="module")
def dataset(dataset_folder):
    return Dataset.load(dataset_folder)


def test_the_harness_sees_everything(dataset, dataset_folder):
    assert dataset.name == dataset.scene == "planes"
    assert [view.name for view in dataset.test_views()] == ["v00", "v03"]
    assert len(dataset.training_views()) == 4 and dataset.has_points
    assert dataset.blur == Blur(gamma=2.2, alpha=4.0)
    assert dataset.checksum == sha256_file(dataset_folder / "dataset.json")
    lenses = json.loads((dataset_folder / "lens.json").read_text())
    assert dataset.disparity_range.q_min == lenses["disparity_range"][0]
    for view, record in zip(dataset.views, lenses["views"], strict=True):
        assert view.lens == Lens(record["aperture"], record["focus"]) == dataset.lens(view.name)
        assert view.physical_lens.aperture == pytest.approx(record["aperture_scene"], rel=FLOAT64_VALUE)
        assert view.physical_lens.focus_depth == pytest.approx(record["focus_scene"], rel=FLOAT64_VALUE)
        assert view.physical_lens.width == view.camera.width == 128
        assert view.max_coc_px == record["max_coc_px"]


def test_images_are_the_files(dataset, dataset_folder):
    view = dataset.views[2]
    np.testing.assert_array_equal(dataset.image(view), read_image(dataset_folder / "images/v02.png"))
    np.testing.assert_array_equal(dataset.linear("v02"), read_exr(dataset_folder / "images_linear/v02.exr"))
    np.testing.assert_array_equal(dataset.all_in_focus(view), read_image(dataset_folder / "all_in_focus/v02.png"))
    np.testing.assert_array_equal(dataset.depth(view), read_exr(dataset_folder / "depth/v02.exr"))


def test_a_method_sees_photographs_cameras_and_points(dataset, dataset_folder, scene):
    training = dataset.training_set()
    # Nothing else can hide in these types: no lens, no depth, no path.
    assert {field.name for field in dataclasses.fields(TrainingSet)} == {"views", "points", "offset"}
    assert {field.name for field in dataclasses.fields(TrainingView)} == {"name", "camera", "image", "exif", "mask"}
    assert [view.name for view in training.views] == ["v01", "v02", "v04", "v05"]
    for view in training.views:
        np.testing.assert_array_equal(view.image, read_image(dataset_folder / f"images/{view.name}.png"))
    # Points 0 ... 3 are seen by the test views alone; the others by v00, v01, v02, v04.
    every = load_scene(scene).points
    np.testing.assert_allclose(training.points.xyz, every.xyz[4:])
    assert isinstance(training.points, PointCloud) and len(training.points) == 16
    assert all(track.tolist() == [0, 1, 2] for track in training.points.views)


def test_sharp_training_photographs_are_a_protocol_of_their_own(dataset, dataset_folder):
    sharp = dataset.training_set("all-in-focus")
    for view in sharp.views:
        np.testing.assert_array_equal(view.image, read_image(dataset_folder / f"all_in_focus/{view.name}.png"))
    with pytest.raises(InputError, match="all-in-focus"):
        dataset.training_set("all_in_focus")


def test_a_scene_without_points(write_scene, tmp_path):
    root = write_scene(tmp_path / "bare", points=False)
    dataset = Dataset.load(make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent()))
    assert not dataset.has_points and len(dataset.training_set().views) == 4


def test_a_picture_that_changed_is_told(dataset_folder, tmp_path):
    copy = shutil.copytree(dataset_folder, tmp_path / "copy")
    dataset = Dataset.load(copy)
    name, other = dataset.views[0].name, dataset.views[1].name
    for part, below in (("image", "images"), ("all_in_focus", "all_in_focus")):
        dataset.require_intact(name, part)
        file = copy / below / f"{name}.png"
        shutil.copyfile(copy / below / f"{other}.png", file)
        with pytest.raises(InputError, match="a changed file"):
            dataset.require_intact(name, part)
        file.unlink()
        with pytest.raises(InputError, match="no such file of the dataset"):
            dataset.require_intact(name, part)
        dataset.require_intact(other, part)


def test_an_unknown_view(dataset):
    with pytest.raises(InputError, match="no view 'v99'"):
        dataset.view("v99")


def test_where_the_built_in_dataset_is():
    assert builtin_folder().as_posix() == "data/tabletop"


# ---- folders that are refused ----


@pytest.fixture
def folder(dataset_folder, tmp_path):
    return shutil.copytree(dataset_folder, tmp_path / "copy")


def manifest_with(folder, **values):
    edit_json(folder / "dataset.json", lambda content: content.update(values))


@pytest.mark.parametrize(
    "spoil, word",
    [
        (lambda folder: shutil.rmtree(folder), "no such folder"),
        (lambda folder: (folder / "dataset.json").unlink(), "as make-dataset writes it"),
        (lambda folder: ((folder / "dataset.json").unlink(), (folder / ".work").mkdir()), "run make-dataset again"),
        (lambda folder: (folder / "dataset.json").write_text("{"), "JSON"),
        (lambda folder: (folder / "dataset.json").write_text("[]"), "another kind of JSON"),
        (lambda folder: manifest_with(folder, version=5), "schema version 5"),
        (lambda folder: manifest_with(folder, version=2), "a digest in schema version 2"),
        (lambda folder: manifest_with(folder, points=None), "no points in schema version 4"),
        (lambda folder: manifest_with(folder, seed="lucky"), "seed"),
        (lambda folder: (folder / "lens.json").unlink(), "lens.json"),
        (lambda folder: (folder / "transforms.json").unlink(), "transforms.json"),
    ],
)
def test_a_folder_that_is_no_dataset(folder, spoil, word):
    spoil(folder)
    with pytest.raises(InputError) as caught:
        Dataset.load(folder)
    assert word in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change, word",
    [
        (lambda lenses: lenses["views"].pop(), "v05"),
        (lambda lenses: lenses["views"][0].update(split="train"), "another split"),
        (lambda lenses: lenses.update(disparity_range=[1.0, 0.5]), "disparity range"),
        (lambda lenses: lenses["shape"].update(blades=2), "blades"),
    ],
)
def test_parts_that_do_not_fit_together(folder, change, word):
    edit_json(folder / "lens.json", change)
    relist(folder)
    with pytest.raises(InputError, match=word):
        Dataset.load(folder)


# ---- files that aren't those of the manifest ----


@pytest.mark.parametrize("file", ["images/v01.png", "depth/v02.exr", "all_in_focus/v00.png", "sparse/0/images.bin"])
def test_a_changed_file_of_equal_size_is_named(folder, file):
    assert Dataset.load(folder).views
    content = bytearray((folder / file).read_bytes())
    times = (folder / file).stat()
    content[len(content) // 2] ^= 4
    (folder / file).write_bytes(content)
    os.utime(folder / file, ns=(times.st_atime_ns, times.st_mtime_ns))  # as a copy that keeps times does
    with pytest.raises(InputError, match=f"{file}: found a changed file"):
        Dataset.load(folder)


def test_training_images_in_place_of_others_are_named(folder):
    for sharp in (folder / "all_in_focus").iterdir():
        shutil.copyfile(sharp, folder / "images" / sharp.name)
    with pytest.raises(InputError, match=r"images/v00\.png: found a changed file"):
        Dataset.load(folder)


@pytest.mark.parametrize("file", ["exif.json", "sparse/0/points3D.txt", "colmap/sparse/0/cameras.bin"])
def test_a_file_that_would_be_read_as_well_must_be_listed(folder, file):
    (folder / file).parent.mkdir(parents=True, exist_ok=True)
    (folder / file).write_text("{}")
    with pytest.raises(InputError, match=f"{file}: found a file that dataset.json doesn't list"):
        Dataset.load(folder)


def test_notes_of_the_user_are_no_obstacle(folder):
    (folder / ".git").mkdir()
    (folder / ".git" / "config").write_text("x")
    (folder / "notes.txt").write_text("mine")
    assert Dataset.load(folder).views


def places(value, path=()):
    """Every place of a number, a text, a truth or nothing in JSON content."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(item, (*path, key))
    else:
        yield path


def other_than(value):
    return value + "x" if isinstance(value, str) else not value if isinstance(value, bool) else (value or 0) + 1


def test_every_changed_field_of_the_manifest_is_noticed(folder):
    file = folder / "dataset.json"
    whole = json.loads(file.read_text())
    for path in places(whole):
        changed = copy.deepcopy(whole)
        *parents, last = path
        inner = functools.reduce(lambda part, key: part[key], parents, changed)
        inner[last] = other_than(inner[last])
        file.write_text(json.dumps(changed, indent=2, ensure_ascii=False) + "\n")
        with pytest.raises(InputError):
            Dataset.load(folder)


def test_random_bits_of_the_manifest_are_noticed(folder):
    file, generator = folder / "dataset.json", random.Random(48)
    whole = file.read_bytes()
    for _ in range(200):
        place, bit = generator.randrange(len(whole)), 1 << generator.randrange(8)
        file.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        with pytest.raises(InputError):
            read_manifest(folder)


def test_a_manifest_without_its_digest_is_refused(folder):
    edit_json(folder / "dataset.json", lambda manifest: manifest.pop("digest"))
    with pytest.raises(InputError, match="no digest in schema version 4"):
        Dataset.load(folder)
