"""Every named layout can be read, and incomplete or different scenes are reported as such."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.scenes.export import write_colmap, write_poses_bounds, write_transforms
from dofbench.scenes.listing import inspect
from dofbench.scenes.named import named_datasets, resolve
from dofbench.scenes.named.library import source_of
from dofbench.scenes.named.schema import NamedScene

LIBRARY = named_datasets()
SIZE = (528, 396)
COUNT = 20


@pytest.fixture(scope="module")
def photograph(tmp_path_factory, write_images):
    """One image, which all scenes here are made of."""
    folder = tmp_path_factory.mktemp("one")
    write_images(folder, ["a.png"], SIZE)
    return folder / "a.png"


@pytest.fixture
def write_scene(photograph, make_cameras, make_cloud):
    """`write_scene(folder, layout, count, folder_of_images)`: a scene in just that layout."""

    def images(folder, names):
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).hardlink_to(photograph)

    def write(root, layout, count, folder="images"):
        names = [f"{index:05d}.png" for index in range(count)]
        cameras = make_cameras(count, size=(2 * SIZE[0], 2 * SIZE[1]))
        cloud = make_cloud(cameras)
        if layout in ("llff", "deblurnerf", "dofnerf"):
            for stack in ("f11", "f4_bak", "f4_obj") if layout == "dofnerf" else ("",):
                images(root / "images" / stack, names)
            write_poses_bounds(root / "poses_bounds.npy", cameras, np.ones((count, 2)))
            write_colmap(root, names, cameras, cloud)
        elif layout == "colmap":
            # As 3DGS ships Tanks and Temples: images smaller than their cameras.
            images(root / folder, names)
            write_colmap(root, names, cameras, cloud)
        elif layout == "nerfstudio":
            images(root / "images", names)
            write_transforms(root / "transforms.json", [f"images/{name}" for name in names], cameras)
            (root / "scene.json").write_text(json.dumps({"schema": "dofbench-scene", "licence": "CC0-1.0"}))
        elif layout == "lightfield":
            # Three full rows around the centre, but for a view at the end of one.
            names = [f"{row:02d}_{column:02d}.png" for row in range(3) for column in range(7)]
            images(root / "views", names[:count])
            (root / "grid.json").write_text('{"centre": "01_03"}')
        else:
            assert layout == "blb"
            root.mkdir(parents=True)
            (root / "info.json").write_text('{"blur_parameters": [1], "focus_distances": [1]}')

    return write


ALL = [
    (dataset, scene)
    for dataset in LIBRARY.values()
    if not dataset.built_in
    for scene in (dataset.scenes if dataset.marker is None else (NamedScene(name="some"),))
]


@pytest.mark.parametrize(("dataset", "scene"), ALL, ids=[f"{dataset.id}/{scene.name}" for dataset, scene in ALL])
def test_every_named_scene_is_found_and_read(tmp_path, write_scene, dataset, scene):
    source, original = source_of(LIBRARY, dataset, scene)
    # Large scenes are written with fewer images than required, since 300 images wouldn't test more.
    count = min(original.views or COUNT, COUNT)
    root = tmp_path / source.candidates(original)[0]
    write_scene(root, str(source.layout), count, original.images or "images")
    if original.rendered is not None:
        made = {"schema": "dofbench-scene", "recipe": original.rendered.recipe, "seed": original.rendered.seed}
        (root / "scene.json").write_text(json.dumps(made))
    (found,) = resolve(f"{dataset.id}/{scene.name}", tmp_path)
    presence = inspect(found)
    if original.sha256 and original.views == count:
        assert presence.state == "different" and "checksum" in presence.detail
    elif original.views is not None and original.views > count:
        assert presence.state == "incomplete" and f"{count} views" in presence.detail
    elif original.size is not None:
        assert presence.state == "different" and f"expected {original.size[0]}x" in presence.detail
    else:
        assert presence.state == ("here" if original.views is None else "complete")
    if source.layout == "lightfield":
        assert presence.training == count
    if source.layout in ("blb", "lightfield"):  # no scenes with poses
        return
    loaded = found.load()
    assert loaded.layout == source.layout and loaded.name == f"{dataset.id}-{scene.name}"
    assert loaded.photographs == ("shallow" if source.layout in ("deblurnerf", "dofnerf") else "all-in-focus")
    hold, first = original.hold or source.hold or 8, 1 if source.layout == "dofnerf" else 0
    assert [index for index, view in enumerate(loaded.views) if view.split == "test"] == [*range(first, count, hold)]
    assert loaded.views[0].camera.width == (found.recipe.width or SIZE[0])
    assert presence.training + presence.test == count


def test_complete_contradicting_and_unreadable_scenes(tmp_path, write_scene):
    write_scene(tmp_path / "nerf_llff_data" / "orchids", "llff", 25)
    presence = inspect(resolve("llff/orchids", tmp_path)[0])
    assert (presence.state, presence.training, presence.test) == ("complete", 21, 4) and not presence.is_problem
    root = tmp_path / "real_defocus_blur" / "defocuscups"
    write_scene(root, "deblurnerf", COUNT)
    (root / "hold=8").touch()
    (scene,) = resolve("deblur-nerf-real/cups", tmp_path)
    assert inspect(scene).state == "here"
    (root / "hold=8").rename(root / "hold=6")
    presence = inspect(scene)
    assert presence.state == "different" and "hold=6" in presence.detail and "expected hold=8" in presence.detail
    (tmp_path / "llff_room").mkdir()
    presence = inspect(resolve("llff/room", tmp_path)[0])
    assert presence.state == "unreadable" and presence.is_problem and "llff_room" in presence.detail


def test_rendered_scenes_by_their_marker(tmp_path, write_scene):
    (tmp_path / "scenes" / "other").mkdir(parents=True)
    (tmp_path / "scenes" / "other" / "scene.json").write_text('{"schema": "something else"}')
    for text in ("rendered/other", "rendered"):
        with pytest.raises(InputError, match="found none of it in"):
            resolve(text, tmp_path)
    for place in LIBRARY["rendered"].folders[:2]:
        write_scene(tmp_path / place.replace("{scene}", "fence"), "nerfstudio", 9)
    (scene,) = resolve("rendered", tmp_path)
    assert scene.root == tmp_path / "scenes" / "fence"


@pytest.mark.parametrize("given", ["option", "variable"])
def test_the_command_lists_what_is_here_and_what_to_put_where(tmp_path, write_scene, capsys, monkeypatch, given):
    write_scene(tmp_path / "nerf_llff_data" / "orchids", "llff", 25)
    write_scene(tmp_path / "real_defocus_blur" / "defocussausage", "deblurnerf", COUNT)
    monkeypatch.delenv("DOFBENCH_DATA", raising=False)
    if given == "variable":
        monkeypatch.setenv("DOFBENCH_DATA", str(tmp_path))
    assert app.main(["scenes", *(["--data-root", str(tmp_path)] if given == "option" else [])]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "llff/orchids report complete 21 + 4 test, 504x378" in text
    assert "dof-gaussian/orchids report complete 21 + 4 test" in text
    assert "deblur-nerf-real/sausage report here 16 + 4 test, 528x396 its author agrees" in text
    assert f"put nerf_llff_data/SCENE, llff/SCENE or llff_SCENE in {tmp_path}; from https://bmild" in text
    assert "put the scenes of llff and tandt-db, as said there" in text
    assert "excluded: tandt-db/playroom: indoors" in text
    assert "excluded: bush" in text
    assert f"put scenes/SCENE or rendered/SCENE in {tmp_path}; made by `dofbench make-scene all`" in text


def test_the_command_without_a_data_root_lists_all_and_says_how_to_look(capsys, monkeypatch):
    monkeypatch.delenv("DOFBENCH_DATA", raising=False)
    assert app.main(["scenes"]) == 0
    text = capsys.readouterr().out
    assert all(dataset.title in text for dataset in LIBRARY.values())
    assert "--data-root DIR, or set DOFBENCH_DATA" in text and "absent" not in text


def test_the_command_fails_when_something_here_is_not_whole(tmp_path, write_scene, capsys):
    write_scene(tmp_path / "nerf_llff_data" / "orchids", "llff", 24)
    assert app.main(["scenes", "--data-root", str(tmp_path)]) == 1
    assert "incomplete" in capsys.readouterr().out
    assert app.main(["scenes", "--data-root", str(tmp_path / "nowhere")]) == 2


def test_real_scenes_are_complete(real_data):
    root = real_data("llff_fern").parent
    here = {found.scene.label: found for found in map(inspect, resolve("llff", root)) if found.state != "absent"}
    assert {label: (found.state, found.training, found.test) for label, found in here.items()} == {
        "llff/fern": ("complete", 17, 3),
        "llff/flower": ("complete", 29, 5),
    }
