"""What a user types, and the scenes that it means: folders, built-in scenes, datasets, single scenes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.scenes.export import write_poses_bounds
from dofbench.scenes.named import find_data_root, named_datasets, places, resolve

Write = Callable[..., None]


@pytest.fixture
def shelf(tmp_path, make_cameras, write_images):
    """A data root with two LLFF scenes under their different names, and one of Deblur-NeRF's."""

    def write(folder, count, sizes):
        for images, size in sizes.items():
            write_images(folder / images, ["000.png"], size)
            for index in range(1, count):
                os.link(folder / images / "000.png", folder / images / f"{index:03d}.png")
        cameras = make_cameras(count, size=(4032, 3024))
        write_poses_bounds(folder / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (count, 1)))

    small = {"images_4": (1008, 756), "images_8": (504, 378)}
    write(tmp_path / "nerf_llff_data" / "orchids", 25, small)
    write(tmp_path / "llff_leaves", 10, small)
    write(tmp_path / "real_defocus_blur" / "defocuscups", 12, {"images_4": (24, 18)})
    return tmp_path


def test_a_folder_is_itself_and_a_known_scene_by_its_files(shelf, tmp_path):
    (scene,) = resolve(str(tmp_path / "nerf_llff_data"), None)
    assert (scene.root, scene.label, scene.name) == (tmp_path / "nerf_llff_data", "nerf_llff_data", "nerf_llff_data")
    assert (scene.dataset, scene.layout, scene.hold, scene.licence) == (None, "auto", None, "not stated")
    (scene,) = resolve(str(shelf / "llff_leaves"), None)
    assert scene.dataset == "llff" and "NeRF" in scene.citation[1]
    assert (scene.layout, scene.hold, scene.recipe.width, scene.label) == ("auto", None, None, "llff_leaves")
    (shelf / "llff_leaves").rename(shelf / "llff_fern")
    (scene,) = resolve(str(shelf / "llff_fern"), None)
    assert scene.dataset is None and not scene.citation


def test_a_folder_of_a_known_set_of_blurred_photographs_is_read_as_such(shelf):
    (scene,) = resolve(str(shelf / "real_defocus_blur" / "defocuscups"), None)
    assert (scene.dataset, scene.layout, scene.hold) == ("deblur-nerf-real", "deblurnerf", 8)
    loaded = scene.load()
    assert loaded.photographs == "shallow" and loaded.name == "defocuscups"
    assert [view.name for view in loaded.test_views()] == ["000", "008"]


def test_a_rendered_scene_says_whose_it_is(shelf):
    folder = shelf / "rendered" / "glasses"
    folder.mkdir(parents=True)
    content = {"schema": "dofbench-scene", "licence": "CC0-1.0", "origin": "made", "citation": "a report"}
    (folder / "scene.json").write_text(json.dumps(content))
    for text, root in ((str(folder), None), ("rendered/glasses", shelf), ("rendered", shelf)):
        (scene,) = resolve(text, root)
        assert (scene.root, scene.licence, scene.origin, scene.citation) == (folder, "CC0-1.0", "made", ("a report",))
    assert scene.label == "rendered/glasses"


def test_the_built_in_scene_needs_no_data_root():
    (scene,) = resolve("tabletop", None)
    assert (scene.root, scene.label, scene.name) == (content_folder("datasets") / "tabletop", "tabletop", "tabletop")
    assert len(scene.load().views) == scene.views == 20


def test_a_built_in_scene_that_a_wheel_lacks_names_the_command_that_makes_it(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "content_folder", lambda name: tmp_path)
    with pytest.raises(InputError, match=r"not part of this installation.*make-scene night .*--out thinlens/night"):
        resolve("thinlens/night", None)


def test_one_scene_of_a_dataset_and_options_that_win(shelf):
    (scene,) = resolve("llff/orchids", shelf)
    assert (scene.root, scene.name, scene.hold) == (shelf / "nerf_llff_data" / "orchids", "llff-orchids", 8)
    loaded = scene.load()
    assert (loaded.name, loaded.views[0].camera.width, len(loaded.test_views())) == ("llff-orchids", 504, 4)
    (scene,) = resolve("llff/orchids", shelf)
    assert scene.load(width=100).views[0].camera.width == 100
    wide = scene.load(images="images_4", hold=5)
    assert wide.views[0].camera.width == 1008 and len(wide.test_views()) == 5
    assert scene.reading(layout="colmap")["layout"] == "colmap"
    with pytest.raises(InputError, match="no COLMAP model"):
        scene.load(layout="colmap")


def test_all_scenes_of_a_dataset_with_those_that_are_absent(shelf):
    scenes = resolve("llff", shelf)
    assert [scene.label for scene in scenes] == [f"llff/{scene.name}" for scene in named_datasets()["llff"].scenes]
    assert {scene.label for scene in scenes if not scene.missing} == {"llff/orchids", "llff/leaves"}
    fern = scenes[0]
    assert "nerf_llff_data/fern, llff/fern or llff_fern in" in fern.missing and "bmild.github.io" in fern.missing
    with pytest.raises(InputError, match="llff/fern: found no such scene here, expected nerf_llff_data/fern"):
        fern.load()


def test_a_short_name_is_the_scene_of_that_name(shelf):
    assert resolve("orchids", shelf) == resolve("llff/orchids", shelf)
    assert resolve("cups", shelf)[0].label == "deblur-nerf-real/cups"
    # Also of sets whose scenes are found by a marker; a set's own name comes first.
    (shelf / "dof_nerf" / "plant").mkdir(parents=True)
    (shelf / "dof_nerf" / "plant" / "poses_bounds.npy").touch()
    assert resolve("plant", shelf)[0].label == "dof-nerf/plant"
    assert resolve("tabletop", shelf)[0].label == "tabletop"


def test_of_scenes_of_one_name_the_one_that_is_here_counts(shelf):
    with pytest.raises(
        InputError, match="room: found a name of several scenes, expected one of llff/room, .*real/room"
    ):
        resolve("room", shelf)
    (shelf / "llff_room").mkdir()
    assert resolve("room", shelf)[0].label == "llff/room"
    (shelf / "report" / "real_room").mkdir(parents=True)
    with pytest.raises(InputError, match="expected one of llff/room, real/room$"):
        resolve("room", shelf)


def test_a_scene_of_the_papers_set_is_its_source_with_both_citations(shelf):
    paper, source = resolve("dof-gaussian/orchids", shelf)[0], resolve("llff/orchids", shelf)[0]
    assert paper.root == source.root and paper.reading() == source.reading()
    assert paper.licence == source.licence and paper.name == "dof-gaussian-orchids"
    assert paper.citation[1:] == source.citation and "DoF-Gaussian" in paper.citation[0]


def test_the_first_folder_wins_and_a_folder_over_a_name(shelf, monkeypatch):
    (shelf / "llff_orchids").mkdir()
    assert resolve("llff/orchids", shelf)[0].root == shelf / "nerf_llff_data" / "orchids"
    (shelf / "llff" / "fern").mkdir(parents=True)
    monkeypatch.chdir(shelf)
    assert resolve("llff/fern", None)[0].root == Path("llff/fern")


# ---- wrong input is one line ----


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lff/fern", "llff/fern"),
        ("fern", "llff/fern"),
        ("llf", "llff"),
        ("dof-gausian", "dof-gaussian"),
        ("llff/ferm", "llff/fern"),
        ("tabeltop", "tabletop"),
        ("nothing like it", "a scene folder, or one of tabletop"),
        ("dof-gaussian/leaves", "dof-gaussian"),
        ("", "a scene folder, or one of"),
    ],
)
def test_unknown_names_are_answered_with_close_ones(shelf, text, expected):
    with pytest.raises(InputError) as caught:
        resolve(text, shelf)
    assert expected in caught.value.expected and "\n" not in str(caught.value)


def test_absent_scenes_are_answered_with_what_to_put_where(shelf):
    with pytest.raises(InputError, match=r"llff/room: found none of it in .*, expected nerf_llff_data/room"):
        resolve("llff/room", shelf)
    with pytest.raises(InputError, match=r"llff: found no data root, expected nerf_llff_data/SCENE.* --data-root"):
        resolve("llff", None)
    with pytest.raises(InputError, match=r"tandt-db: found none of it in .*tandt_db.zip"):
        resolve("tandt-db", shelf)
    with pytest.raises(InputError, match=r"rendered: found none of it in .*rendered/SCENE .*make-scene"):
        resolve("rendered", shelf)
    with pytest.raises(InputError, match=r"dof-nerf/plant: found none of it in"):
        resolve("dof-nerf/plant", shelf)


def test_data_root(shelf, tmp_path, monkeypatch):
    monkeypatch.delenv("DOFBENCH_DATA", raising=False)
    assert find_data_root() is None
    monkeypatch.setenv("DOFBENCH_DATA", str(shelf))
    assert find_data_root() == shelf
    assert find_data_root(shelf / "nerf_llff_data") == shelf / "nerf_llff_data"
    with pytest.raises(InputError, match="--data-root: found .*nowhere, which is no folder"):
        find_data_root(tmp_path / "nowhere")
    monkeypatch.setenv("DOFBENCH_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="DOFBENCH_DATA: found "):
        find_data_root()


@pytest.mark.parametrize(("name", "views"), [("fern", 20), ("flower", 34)])
def test_real_scenes_are_found_as_what_they_are(real_data, name, views):
    root = real_data(f"llff_{name}").parent
    (scene,) = resolve(f"llff/{name}", root)
    assert scene.root == root / f"llff_{name}" and scene.views == views
    (folder,) = resolve(str(root / f"llff_{name}"), None)
    assert folder.dataset == "llff", "by its checksum"
    assert (folder.citation, folder.licence) == (scene.citation, scene.licence)
