"""Splits that files name, what they may call the views, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms

COUNT = 6
NAMES = [f"IMG_{index}.JPG" for index in range(COUNT)]
TEST, TRAIN = [NAMES[1], NAMES[4]], [NAMES[0], *NAMES[2:4], NAMES[5]]
EXPECTED = ["IMG_1", "IMG_4"]


@pytest.fixture
def folder(tmp_path, make_cameras, make_cloud, write_images):
    """A COLMAP scene whose images are PNGs in images/, though the model has cameras' names."""
    cameras = make_cameras(COUNT)
    write_images(tmp_path / "images", [name.replace("JPG", "png") for name in NAMES])
    write_colmap(tmp_path, NAMES, cameras, make_cloud(cameras))
    return tmp_path


def lines(names):
    return "\n".join(names) + "\n"


@pytest.mark.parametrize(
    "spelled", [str, lambda n: n.removesuffix(".JPG"), lambda n: f"images/{n}", lambda n: f".\\{n}"]
)
@pytest.mark.parametrize(
    "write",
    [
        lambda root, test, train: (root / "sparse/0/test.txt").write_text(lines(test)),
        lambda root, test, train: (root / "test.txt").write_text("\ufeff# test\r\n\r\n" + "\r\n".join(test)),
        lambda root, test, train: (root / "train.txt").write_text("\n".join(train)),
        lambda root, test, train: [
            (root / f"{n}.txt").write_text(lines(x)) for n, x in (("test", test), ("train", train))
        ],
        lambda root, test, train: (root / "split.json").write_text(json.dumps({"train": train, "test": test})),
        lambda root, test, train: (root / "train_test_lists.json").write_text(
            json.dumps({"train": train, "test": test, "has_masks": False})
        ),
    ],
)
def test_named_views_are_test_views(folder, write, spelled):
    write(folder, [spelled(name) for name in TEST], [spelled(name) for name in TRAIN])
    scene = load_scene(folder)
    assert [view.name for view in scene.test_views()] == EXPECTED
    assert {view.name for view in scene.training_set().views} == {Path(name).stem for name in TRAIN}
    assert any(scene.split_by in note for note in scene.notes)


def test_an_explicit_hold_goes_first_and_is_said(folder):
    default = load_scene(folder)
    assert default.split_by == "hold 8 (default)" and not any("split" in note for note in default.notes)
    (folder / "test.txt").write_text(lines(TEST))
    scene = load_scene(folder, hold=3)
    assert [view.name for view in scene.test_views()] == ["IMG_0", "IMG_3"]
    assert any("test.txt" in note for note in scene.notes)


def test_files_that_agree_may_be_several(folder):
    (folder / "test.txt").write_text(lines(TEST))
    (folder / "sparse/0/test.txt").write_text(lines(TEST[::-1]))
    assert [view.name for view in load_scene(folder).test_views()] == EXPECTED
    (folder / "sparse/0/test.txt").write_text(lines(TEST[:1]))
    with pytest.raises(InputError, match=r"IMG_4 otherwise than test\.txt"):
        load_scene(folder)


def test_views_for_validation_alone_are_skipped(folder):
    (folder / "split.json").write_text(json.dumps({"train": TRAIN[:3], "test": TEST, "val": TRAIN[3:]}))
    scene = load_scene(folder)
    assert [view.name for view in scene.views] == ["IMG_0", "IMG_1", "IMG_2", "IMG_3", "IMG_4"]
    assert scene.points is not None and max(track.max() for track in scene.points.views) == 4
    assert any("1 for validation alone skipped" in note for note in scene.notes)


def test_images_without_a_pose_may_be_named(folder, write_images):
    write_images(folder / "images", ["IMG_9.png"])
    (folder / "test.txt").write_text(lines([*TEST, "IMG_9.JPG"]))
    assert [view.name for view in load_scene(folder).test_views()] == EXPECTED


@pytest.mark.parametrize(
    ("test", "train", "said"),
    [
        ([*TEST, "IMG_77.JPG"], None, r"IMG_77\.JPG in test"),
        ([*TEST, TRAIN[0]], TRAIN, "IMG_0 in train and in test"),
        (TEST[:1], TRAIN, "IMG_4 in neither list"),
        ([*TEST, TEST[0]], None, r"IMG_1\.JPG several times"),
        ([], None, "6 training and 0 test views"),
        (NAMES, None, "0 training and 6 test views"),
        (["../IMG_1.JPG"], None, r"a path with \.\."),
        (["0", "2"], None, "0, 2 in test"),  # numbers are no names
    ],
)
def test_contradictions_and_strangers_are_refused(folder, test, train, said):
    (folder / "test.txt").write_text(lines(test))
    if train is not None:
        (folder / "train.txt").write_text(lines(train))
    with pytest.raises(InputError, match=said):
        load_scene(folder)
    assert load_scene(folder, hold=3).test_views()


@pytest.mark.parametrize("text", ["[1, 2]", "{}", '{"test": "IMG_1"}', '{"test": [1]}', "{", "[" * 100_000])
def test_json_that_is_no_split_is_refused(folder, text):
    (folder / "split.json").write_text(text)
    with pytest.raises(InputError, match=r"split\.json"):
        load_scene(folder)


def test_names_that_several_views_have_are_refused(tmp_path, make_cameras, write_images):
    names = ["left/a.png", "right/a.png", "left/b.png"]
    write_images(tmp_path / "images", names)
    write_colmap(tmp_path, names, make_cameras(3), None)
    (tmp_path / "test.txt").write_text("a.png\n")
    with pytest.raises(InputError, match=r"a\.png, which may be images/left/a\.png, images/right/a\.png"):
        load_scene(tmp_path)
    (tmp_path / "test.txt").write_text("right/a.png\nb.png\n")
    assert [view.name for view in load_scene(tmp_path).test_views()] == ["left_b", "right_a"]


def test_lists_of_transforms_json_and_files(tmp_path, make_cameras, write_images):
    paths = [f"images/{index}.png" for index in range(4)]
    write_images(tmp_path, paths)
    splits = ["train", "test", "train", "train"]
    write_transforms(tmp_path / "transforms.json", paths, make_cameras(4), splits=splits)
    (tmp_path / "test.txt").write_text("1.png\n")
    scene = load_scene(tmp_path)
    assert [view.name for view in scene.test_views()] == ["1"] and "transforms.json" in scene.split_by
    assert not scene.notes
    (tmp_path / "test.txt").write_text("2.png\n")
    with pytest.raises(InputError, match=r"1, 2 in test\.txt otherwise than in the lists of transforms\.json"):
        load_scene(tmp_path)


def table(rows, separator="\t"):
    """Phototourism's: filename, id, split, dataset."""
    lines_of = [("filename", "id", "split", "dataset"), *((*row, "gate") for row in rows)]
    return "\n".join(separator.join(row) for row in lines_of) + "\n"


@pytest.mark.parametrize(("file", "separator"), [("split.tsv", "\t"), ("split.csv", ","), ("brandenburg.tsv", "\t")])
def test_a_table_names_views_of_neither_part_too(folder, file, separator):
    rows = [(NAMES[0], "1", "train"), (NAMES[1], "2", "test"), (NAMES[2], "", "test"), (NAMES[3], "4", "train")]
    (folder / file).write_text(table([*rows, (NAMES[4], "5", "")], separator))
    scene = load_scene(folder)
    assert [(view.name, view.split) for view in scene.views] == [
        ("IMG_0", "train"),
        ("IMG_1", "test"),
        ("IMG_3", "train"),
    ]
    assert scene.split_by == file and any("3 in neither skipped" in note for note in scene.notes)
    assert len(load_scene(folder, hold=3).views) == COUNT


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image\tpart\nIMG_0.JPG\ttrain\n", "columns image, part"),
        ("filename\tsplit\nIMG_0.JPG\n", "1 columns in line 2"),
        ("filename\tsplit\nIMG_0.JPG\tdev\n", "split dev in line 2"),
        ("filename\tsplit\nIMG_0.JPG\ttrain\nIMG_9.JPG\ttest\n", r"IMG_9\.JPG in test"),
        ("", "columns none"),
    ],
)
def test_tables_that_are_no_split_are_refused(folder, text, said):
    (folder / "split.tsv").write_text(text)
    with pytest.raises(InputError, match=said):
        load_scene(folder)


@pytest.mark.parametrize("key", ["{}_filenames", "{}_ids", "{}_images"])
def test_lists_in_json_by_other_names(folder, key):
    names = [name.removesuffix(".JPG") if "ids" in key else name for name in TEST]
    (folder / "split.json").write_text(json.dumps({key.format("test"): names}))
    assert [view.name for view in load_scene(folder).test_views()] == EXPECTED
    (folder / "split.json").write_text(json.dumps({key.format("test"): names, "test": names}))
    with pytest.raises(InputError, match="one list of them"):
        load_scene(folder)


def test_indices_are_refused_and_unknown_files_named(folder):
    (folder / "split.json").write_text(json.dumps({"train": [0, 2, 3, 5], "test": [1, 4]}))
    with pytest.raises(InputError, match="indices in train and test"):
        load_scene(folder)
    (folder / "split.json").rename(folder / "splits.json")
    assert any("splits.json not read" in note for note in load_scene(folder).notes)
    (folder / "test.txt").write_text(lines(TEST))
    assert not any("splits.json" in note for note in load_scene(folder).notes)


def test_test_frames_are_test_views(tmp_path, make_cameras, write_images):
    paths = [f"images/{index}.png" for index in range(4)]
    write_images(tmp_path, paths)
    file = tmp_path / "transforms.json"
    write_transforms(file, paths, make_cameras(4))
    content = json.loads(file.read_text())
    content["test_frames"] = [content["frames"].pop(1), content["frames"].pop(1)]
    file.write_text(json.dumps(content))
    scene = load_scene(tmp_path)
    assert [view.split for view in scene.views] == ["train", "test", "test", "train"]
    for change in ({"test_filenames": paths[:1]}, {"test_frames": 3}, {"test_frames": content["frames"]}):
        file.write_text(json.dumps({**content, **change}))
        with pytest.raises(InputError, match="test_frames"):
            load_scene(tmp_path)


@pytest.mark.parametrize("layout", ["colmap", "nerfstudio", "llff"])
def test_skipped_images_do_not_move_test_views(tmp_path, make_cameras, write_images, make_cloud, layout):
    names = [f"{index:02d}.png" for index in range(20)]
    cameras = make_cameras(20)
    write_images(tmp_path / "images", names)
    write_colmap(tmp_path, names, cameras, make_cloud(cameras))
    write_transforms(tmp_path / "transforms.json", [f"images/{name}" for name in names], cameras)
    write_poses_bounds(tmp_path / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (20, 1)))
    for name in (names[5], names[16]):
        (tmp_path / "images" / name).unlink()
    scene = load_scene(tmp_path, layout=layout, skip_missing=True)
    assert len(scene.views) == 18 and [view.name for view in scene.test_views()] == ["00", "08"]
    assert [view.name for view in load_scene(tmp_path, layout=layout, skip_missing=True, hold=6).test_views()] == [
        "00",
        "06",
        "12",
        "18",
    ]
    with pytest.raises(InputError, match="hold 17"):
        (tmp_path / "images/00.png").unlink()
        (tmp_path / "images/17.png").unlink()
        load_scene(tmp_path, layout=layout, skip_missing=True, hold=17)
