"""Datasets of photographs that are shallow already: known properties are stored, unknown ones are marked as unknown."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from relisted import edit_json as edit
from relisted import relist
from scipy.ndimage import uniform_filter

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.core.progress import Silent
from dofbench.datasets.format.schema import SourceRecord
from dofbench.datasets.synthesis import Dataset, check_dataset, make_dataset, real_photographs
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.scoring.ground_truth import NO_EXACT_DEPTH, missing_truth
from dofbench.scenes import export, load_scene

TRAIN, TEST = ("v01", "v02", "v04", "v05"), ("v00", "v03")


class Stop(Exception):
    """Ends a run in the middle."""


def write_blurred(root: Path, source: Path, points: bool = True) -> Path:
    """The scene `source` in Deblur-NeRF's layout: views 0 and 3 as they are, all others blurred."""
    scene = load_scene(source)
    names = [f"{view.name}.png" for view in scene.views]
    for view, name in zip(scene.views, names, strict=True):
        image = view.image()
        write_png(root / "images" / name, image if view.split == "test" else uniform_filter(image, (5, 5, 1)))
    cameras = [view.camera for view in scene.views]
    export.write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (len(cameras), 1)))
    export.write_colmap(root, names, cameras, scene.points if points else None)
    (root / "hold=3").touch()
    return root


@pytest.fixture(scope="module")
def blurred(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nobody writes to it."""
    return write_blurred(tmp_path_factory.mktemp("blurred") / "seal", scene)


def make(root: Path, out: Path, layout: str = "deblurnerf", **options) -> Path:
    return make_dataset(MakeDataset(scene=str(root), out=out, layout=layout, **options), progress=Silent())


@pytest.fixture(scope="module")
def made(blurred: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of `blurred`. Nobody writes to it."""
    return make(blurred, tmp_path_factory.mktemp("datasets") / "seal")


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "copy")


def test_what_is_known_is_there_and_nothing_else(made: Path, blurred: Path, contents: Callable) -> None:
    files = {name for name in contents(made) if not name.startswith("sparse/")}
    assert files == {
        *(f"images/{name}.png" for name in TRAIN + TEST),
        *(f"all_in_focus/{name}.png" for name in TEST),
        "dataset.json",
        "lens.json",
        "transforms.json",
        "poses_bounds.npy",
        "contact_sheet.png",
        "README.md",
    }
    lenses = json.loads((made / "lens.json").read_text())
    assert lenses == {
        "views": [
            {"name": name, "split": "test" if name in TEST else "train", "lens": "unknown"}
            for name in sorted(TRAIN + TEST)
        ]
    }
    manifest = json.loads((made / "dataset.json").read_text())
    assert manifest["version"] == 4 and "depth" not in manifest
    assert not {"focus", "aperture", "gamma", "renderer", "assign"} & manifest["settings"].keys()
    for name in TRAIN + TEST:
        np.testing.assert_array_equal(
            read_image(made / f"images/{name}.png"), read_image(blurred / f"images/{name}.png")
        )
    text = (made / "README.md").read_text()
    assert "4 are shallow" in text and "2 are all in focus" in text
    assert "All-in-focus photographs of 4 of 6 views." in text and "Depth of 6 of 6 views." in text
    assert "--layout deblurnerf" in text and "known aperture" not in text
    assert check_dataset(made) == []


def test_the_reader_gives_none_for_what_nobody_knows(made: Path) -> None:
    dataset = Dataset.load(made)
    assert (dataset.assign, dataset.disparity_range, dataset.blur) == ("unknown", None, None)
    assert not dataset.has_exact_depth and dataset.has_points
    for view in dataset.views:
        sharp = view.name in TEST
        assert view.split == ("test" if sharp else "train")
        assert view.lens is view.physical_lens is view.max_coc_px is dataset.lens(view.name) is None
        assert dataset.linear(view) is dataset.depth(view.name) is dataset.confidence(view) is None
        assert view.has_all_in_focus is sharp and not view.has_depth
        assert (dataset.all_in_focus(view) is not None) is sharp
    view = dataset.test_views()[0]
    np.testing.assert_array_equal(dataset.all_in_focus(view), dataset.image(view))


def test_a_method_sees_the_shallow_photographs(made: Path, blurred: Path) -> None:
    dataset = Dataset.load(made)
    training, scene = dataset.training_set(), load_scene(blurred, layout="deblurnerf").training_set()
    assert [view.name for view in training.views] == list(TRAIN)
    for mine, theirs in zip(training.views, scene.views, strict=True):
        np.testing.assert_array_equal(mine.image, theirs.image)
        np.testing.assert_allclose(mine.camera.world_to_camera, theirs.camera.world_to_camera)
    np.testing.assert_allclose(training.points.xyz, scene.points.xyz)
    with pytest.raises(InputError, match=r"no all-in-focus photograph of 4 training views \(v01 first\)"):
        dataset.training_set("all-in-focus")


def test_what_the_cameras_wrote_down_goes_along(blurred: Path, tmp_path: Path) -> None:
    source = shutil.copytree(blurred, tmp_path / "seal")
    (source / "exif.csv").write_text(
        "name,f_number,focal_length_mm,exposure_s,iso\n"
        "v01.png,6.3,55,0.01,400\nv02.png,6.3,55,0.02,400\nv00.png,14,55,0.1,\n"
    )
    folder = make(source, tmp_path / "out")
    dataset = Dataset.load(folder)
    assert {view.name: view.exif.f_number for view in dataset.views if view.exif} == {"v00": 14, "v01": 6.3, "v02": 6.3}
    assert {view.name for view in dataset.training_set().views if view.exif} == {"v01", "v02"}
    text = (folder / "README.md").read_text()
    assert "| f/6.3 | 2 | 55 | 0.01 to 0.02 | 400 |\n| f/14 | 1 | 55 | 0.1 | unknown |\n| unknown | 3 |" in text
    assert "`exif.json`" in text and "exif.json" in dataset.manifest.files
    assert check_dataset(folder) == []
    # Other EXIF is another dataset; the same is the same, byte for byte.
    assert make(source, folder) == folder
    (source / "exif.csv").write_text("name,f_number\nv01.png,8\n")
    with pytest.raises(InputError, match="another dataset"):
        make(source, folder)


def test_focus_distances_are_kept_and_shown(blurred: Path, tmp_path: Path) -> None:
    source = shutil.copytree(blurred, tmp_path / "seal")
    (source / "exif.csv").write_text("name,f_number,focus_distance_m\nv00.png,14,0.8\nv01.png,8,inf\nv02.png,8,1.25\n")
    dataset = Dataset.load(make(source, tmp_path / "out"))
    known = {view.name: view.exif.focus_distance for view in dataset.views if view.exif}
    assert known == {"v00": 0.8, "v01": math.inf, "v02": 1.25}
    text = (tmp_path / "out" / "README.md").read_text()
    assert "focus distance, m" in text and "1.25 to infinity" in text


def test_without_exif_nothing_is_said_of_it(made: Path) -> None:
    assert not (made / "exif.json").exists() and "## EXIF" not in (made / "README.md").read_text()


def test_other_programs_read_it(made: Path) -> None:
    scene = load_scene(made, layout="llff", hold=3)
    assert [view.name for view in scene.test_views()] == list(TEST) and len(scene.points) == 20
    bounds = np.load(made / "poses_bounds.npy")[:, 15:]
    depth = scene.points.xyz[:, 2] + 0.1  # every camera of the scene stands 0.1 behind the world's origin
    np.testing.assert_allclose(bounds, np.tile([depth.min(), depth.max()], (6, 1)))


def test_a_scene_of_a_named_dataset(scene: Path, tmp_path: Path) -> None:
    write_blurred(tmp_path / "real_defocus_blur" / "defocusseal", scene)
    settings = MakeDataset(scene="deblur-nerf-real/seal", data_root=tmp_path, out=tmp_path / "out")
    dataset = Dataset.load(make_dataset(settings, progress=Silent()))
    assert [view.name for view in dataset.test_views()] == ["v00"], "every sixth, as the dataset says"
    assert dataset.manifest.command == "dofbench make-dataset deblur-nerf-real/seal --hold 6 --layout deblurnerf"
    assert dataset.manifest.source.citation and "Deblur-NeRF" in (dataset.folder / "README.md").read_text()


def test_triplets_of_photographs(scene: Path, tmp_path: Path) -> None:
    root, original = tmp_path / "plant", load_scene(scene)
    names = [f"{view.name}.png" for view in original.views]
    for stack, size in (("f11", 1), ("f4_bak", 5), ("f4_obj", 9)):
        for view, name in zip(original.views, names, strict=True):
            write_png(root / "images" / stack / name, uniform_filter(view.image(), (size, size, 1)))
    cameras = [view.camera for view in original.views]
    export.write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (len(cameras), 1)))
    dataset = Dataset.load(make(root, tmp_path / "out", layout="auto", hold=3))
    for index, view in enumerate(dataset.views):
        stack = "f11" if index in (1, 4) else "f4_bak" if index % 2 else "f4_obj"
        np.testing.assert_array_equal(dataset.image(view), read_image(root / "images" / stack / names[index]))
        assert view.has_all_in_focus is (stack == "f11") is (view.split == "test")
    assert check_dataset(dataset.folder) == []
    one = Dataset.load(make(root, tmp_path / "one", layout="auto", hold=3, images="images/f4_bak"))
    assert not any(view.has_all_in_focus for view in one.views) and len(one.test_views()) == 2


def test_they_are_resized_where_asked_for(blurred: Path, tmp_path: Path) -> None:
    dataset = Dataset.load(make(blurred, tmp_path / "out", width=64))
    assert dataset.image("v01").shape == dataset.all_in_focus("v00").shape == (48, 64, 3)
    assert check_dataset(dataset.folder) == []


def test_depth_is_there_where_the_scene_has_it(write_scene: Callable, tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene")

    def forget(content: dict) -> None:
        for index in (0, 2):
            del content["frames"][index]["depth_file_path"]

    whole = Dataset.load(make(root, tmp_path / "whole", layout="auto", photographs="shallow-train"))
    assert whole.has_exact_depth and whole.disparity_range is not None
    np.testing.assert_array_equal(whole.depth("v01"), load_scene(root).views[1].depth())
    edit(root / "transforms.json", forget)
    partial = Dataset.load(make(root, tmp_path / "partial", layout="auto", photographs="shallow-train"))
    assert [view.name for view in partial.views if not view.has_depth] == ["v00", "v02"]
    assert not partial.has_exact_depth and partial.depth("v02") is None and partial.disparity_range is not None
    assert check_dataset(whole.folder) == check_dataset(partial.folder) == []
    assert "of 4 of 6 views" in (partial.folder / "README.md").read_text()
    with pytest.raises(InputError, match="no depth for 2 of 6 views"):
        make(root, tmp_path / "given", layout="auto", photographs="shallow-train", depth="given")


def test_depth_of_another_program(write_scene: Callable, blurred: Path, tmp_path: Path) -> None:
    maps = write_scene(tmp_path / "scene") / "depth"
    dataset = Dataset.load(make(blurred, tmp_path / "out", depth=f"folder:{maps}"))
    assert all(view.has_depth for view in dataset.views) and not dataset.has_exact_depth, "nobody knows how good it is"
    assert missing_truth(dataset).depth == NO_EXACT_DEPTH and missing_truth(dataset).refocus == "no test lens"
    assert "from depth maps of another program" in (dataset.folder / "README.md").read_text()
    assert check_dataset(dataset.folder) == []


def test_of_a_folder_without_sharp_photographs_none_is_made_up(write_scene: Callable, tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene", depth=False, points=False)
    out = tmp_path / "out"
    assert app.main(["make-dataset", str(root), "--photographs", "shallow", "--out", str(out)]) == 0
    dataset = Dataset.load(out)
    assert not any(view.has_all_in_focus or view.has_depth for view in dataset.views)
    # Without depth and points the depth bounds are unknown.
    assert not (out / "all_in_focus").exists() and not (out / "poses_bounds.npy").exists()
    assert "`poses_bounds.npy`: without depth" in (out / "README.md").read_text()
    assert check_dataset(out) == [] and not dataset.has_points


def test_stopped_in_the_middle_it_goes_on(
    blurred: Path, made: Path, tmp_path: Path, contents: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []

    def stopping(path: Path, image: np.ndarray) -> None:
        if len(written) == 4:
            raise Stop
        write_png(path, image)
        written.append(path)

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(real_photographs, "write_png", stopping)
        with pytest.raises(Stop):
            make(blurred, out)
    times = {path: path.stat().st_mtime_ns for path in written}
    make(blurred, out)
    assert contents(out) == contents(made)
    assert times == {path: path.stat().st_mtime_ns for path in written}
    (out / "images" / "v01.png").unlink()  # a finished one that has lost a file since
    make(blurred, out)
    assert contents(out) == contents(made)
    monkeypatch.setattr(real_photographs, "write_png", None)  # complete: nothing is written
    make(blurred, out)


def test_it_is_made_again_from_its_manifest(
    blurred: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["make-dataset", str(blurred), "--like", str(made), "--out", str(tmp_path / "again")]
    assert app.main(call) == 0
    assert f"the same bytes as {made}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options, word",
    [
        (["--focus", "0.3"], "--focus: found 0.3 for seal, whose photographs are shallow already"),
        (["--assign", "continuous", "--focus", "0.1,0.9"], "--focus: found 0.1,0.9 for seal"),
        (["--assign", "continuous", "--focus", "0.2,0.5"], "--focus: found 0.2,0.5 for seal"),
        (["--renderer", "layered"], "--renderer: found layered"),
        (["--bits", "16"], "--bits: found 16"),
        (["--depth", "sfm"], "--depth: found sfm"),
        (["--depth", "splat"], "no estimate"),
    ],
)
def test_how_to_blur_is_no_question(
    blurred: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], word: str
) -> None:
    out = tmp_path / "out"
    call = ["make-dataset", str(blurred), "--layout", "deblurnerf", "--out", str(out), *options]
    assert app.main(call) == 2
    line = capsys.readouterr().err
    assert word in line and line.count("\n") == 1 and not out.exists()


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda folder: (folder / "all_in_focus/v03.png").unlink(), "all_in_focus/v03.png: not listed"),
        (
            lambda folder: shutil.copy(folder / "images/v01.png", folder / "all_in_focus/v03.png"),
            "all_in_focus/v03.png: another picture than images/v03.png",
        ),
        (
            lambda folder: [
                shutil.copy(folder / "images/v01.png", folder / place / "v03.png")
                for place in ("images", "all_in_focus")
            ],
            "view v03, to test on: the same photograph as view v01, to train on",
        ),
        (
            lambda folder: edit(folder / "lens.json", lambda lenses: lenses.update(disparity_range=[0.1, 0.5])),
            "a disparity range, and no depth",
        ),
        (
            lambda folder: edit(
                folder / "dataset.json", lambda content: content["source"]["images"][1].pop("photograph")
            ),
            "view v01: lens unknown, and in dataset.json no real photograph",
        ),
    ],
)
def test_check_finds_what_cannot_be(folder: Path, change: Callable, problem: str) -> None:
    change(folder)
    relist(folder)
    assert any(problem in line for line in check_dataset(folder)), check_dataset(folder)


@pytest.mark.parametrize(
    "file, change, word",
    [
        (
            "dataset.json",
            lambda content: (content.update(version=1), content.pop("digest")),
            "view v00 of unknown lens in schema version 1",
        ),
        ("lens.json", lambda content: content["views"][0].update(aperture=0.5), "aperture"),
        ("lens.json", lambda content: content["views"][0].update(lens="f/4"), "lens"),
        ("lens.json", lambda content: content.update(disparity_range=[0.5, 0.1]), "disparity range"),
    ],
)
def test_the_reader_refuses_what_cannot_be(folder: Path, file: str, change: Callable, word: str) -> None:
    edit(folder / file, change)
    if file != "dataset.json":
        relist(folder)
    with pytest.raises(InputError, match=word) as caught:
        Dataset.load(folder)
    assert "\n" not in str(caught.value)


@pytest.fixture
def mixed(dataset_folder: Path, tmp_path: Path) -> Path:
    """A dataset with known lenses, except that test view v00 is a photograph of unknown lens."""
    folder = shutil.copytree(dataset_folder, tmp_path / "mixed")
    for name in ("images_linear/v00.exr", "all_in_focus/v00.png"):
        (folder / name).unlink()
    edit(
        folder / "lens.json",
        lambda lenses: lenses["views"].__setitem__(0, {"name": "v00", "split": "test", "lens": "unknown"}),
    )
    edit(
        folder / "dataset.json",
        lambda manifest: manifest["source"]["images"][0].update(photograph="shallow"),
    )
    relist(folder)
    return folder


def test_one_test_view_without_a_lens(mixed: Path, dataset_folder: Path) -> None:
    dataset, before = Dataset.load(mixed), Dataset.load(dataset_folder)
    assert check_dataset(mixed) == []
    first, *others = dataset.views
    assert first.lens is None and not first.has_all_in_focus and first.has_depth
    assert [view.lens for view in others] == [view.lens for view in before.views[1:]]
    assert (dataset.assign, dataset.blur, dataset.disparity_range) == ("per-view", before.blur, before.disparity_range)
    edit(mixed / "dataset.json", lambda manifest: (manifest.update(version=1), manifest.pop("digest")))
    with pytest.raises(InputError, match="view v00 of unknown lens in schema version 1"):
        Dataset.load(mixed)


def test_of_a_dataset_with_every_lens_known_no_image_is_called_a_photograph(dataset_folder: Path) -> None:
    manifest = json.loads((dataset_folder / "dataset.json").read_text())
    assert "photographs" not in manifest["settings"]
    assert not any("photograph" in image for image in manifest["source"]["images"])


def test_datasets_of_older_schema_versions_are_read(mixed: Path, dataset_folder: Path, tmp_path: Path) -> None:
    """They say nothing of their points: version 1 knows every lens, version 2 not."""
    known = shutil.copytree(dataset_folder, tmp_path / "known")
    for folder, version in ((known, 1), (mixed, 2)):
        edit(
            folder / "dataset.json",
            lambda manifest, to=version: (
                manifest.update(version=to),
                manifest.pop("points"),
                manifest.pop("digest", None),
            ),
        )
        assert check_dataset(folder) == []
        assert Dataset.load(folder).points_record is None


def test_blown_out_photographs_are_shrunk_by_a_factor_that_is_not_whole(blurred: Path, tmp_path: Path, capsys) -> None:
    root = shutil.copytree(blurred, tmp_path / "bright")
    for path in (root / "images").iterdir():
        image = read_image(path)
        image[10:80] = 1.0
        write_png(path, image)
    for width in ("39", "54", "71"):
        call = ["make-dataset", str(root), "--photographs", "shallow", "--width", width, "--out", str(tmp_path / width)]
        assert app.main(call) == app.DONE, capsys.readouterr().err
        assert read_image(tmp_path / width / "images/v01.png").max() == 1


def test_coverage_trains_on_every_second_test_photograph(blurred: Path, scene: Path, tmp_path: Path) -> None:
    whole = make(blurred, tmp_path / "whole", layout="colmap", photographs="shallow", hold=2)
    half = make(blurred, tmp_path / "half", layout="colmap", photographs="shallow", hold=2, coverage=True)
    tested = [[view.name for view in Dataset.load(folder).test_views()] for folder in (whole, half)]
    assert tested == [["v00", "v02", "v04"], ["v00", "v04"]]
    assert "--coverage" in Dataset.load(half).manifest.command and check_dataset(half) == []
    assert "1 of 3 test views are trained on as well" in Dataset.load(half).manifest.source.notes
    assert "coverage" not in Dataset.load(whole).manifest.settings, "older recipes stay as they are"
    with pytest.raises(InputError, match="photographs of unknown lens alone"):
        make(blurred, tmp_path / "sharp", coverage=True)
    with pytest.raises(InputError, match="fewer than two test views"):
        make(blurred, tmp_path / "one", layout="colmap", photographs="shallow", hold=6, coverage=True)


def test_photographs_at_their_own_size_are_known_from_smaller_ones(blurred: Path, made: Path, tmp_path: Path) -> None:
    width = Dataset.load(made).views[0].camera.width
    small = Dataset.load(make(blurred, tmp_path / "small", width=width // 2))
    assert Dataset.load(made).full_size and not small.full_size
    assert small.manifest.source.own_side == Dataset.load(made).manifest.source.own_side == width
    older = replace(small, manifest=small.manifest.model_copy(update={"source": _without_size(small)}))
    assert older.full_size is None, "a width was chosen, of a size that isn't stated"
    settings = {**small.manifest.settings, "width": None}
    assert replace(older, manifest=older.manifest.model_copy(update={"settings": settings})).full_size


def _without_size(dataset: Dataset) -> SourceRecord:
    return dataset.manifest.source.model_copy(update={"own_side": None})
