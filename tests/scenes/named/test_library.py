"""datasets/*.toml: every shipped file is valid and says what the papers say; a damaged one is named in one line."""

from __future__ import annotations

import tomllib

import pytest

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.scenes import LAYOUTS
from dofbench.scenes.named import named_datasets
from dofbench.scenes.named.library import read_dataset, read_library, source_of

FILES = sorted(content_folder("datasets").glob("*.toml"))
LIBRARY = named_datasets()

GOOD = """
id = "small"
title = "Small"
origin = "somewhere"
licence = "not stated"
role = "report"
layout = "llff"
folders = ["{scene}"]
[[scenes]]
name = "one"
"""


SCENE_ROLE = GOOD.replace('role = "report"\n', "") + 'role = "report"\n'


def test_files_folders_and_order_of_the_library():
    assert {read_dataset(path).id for path in FILES} == {path.stem for path in FILES} == set(LIBRARY)
    assert {
        "tabletop",
        "llff",
        "tandt-db",
        "dof-gaussian",
        "deblur-nerf-real",
        "deblur-nerf-synthetic",
        "dof-nerf",
        "blb",
        "rendered",
    } <= set(LIBRARY)
    # Else one folder would be found as two scenes.
    places = [
        place
        for dataset in LIBRARY.values()
        for scene in dataset.scenes
        if scene.of is None
        for place in dataset.candidates(scene)
    ]
    assert len(set(places)) == len(places)
    flags = [dataset.built_in for dataset in LIBRARY.values()]
    assert flags[0] and flags == sorted(flags, reverse=True)


@pytest.mark.parametrize("dataset", LIBRARY.values(), ids=list(LIBRARY))
def test_every_dataset_says_whose_it_is_and_how_to_read_it(dataset):
    assert dataset.title and dataset.origin and dataset.licence
    assert dataset.citation or dataset.licence.startswith("CC0")
    layouts = {source_of(LIBRARY, dataset, scene)[0].layout for scene in dataset.scenes} or {dataset.layout}
    assert layouts <= {*LAYOUTS, "blb", "lightfield"}


def test_the_published_sets():
    """DoF-Gaussian's supplement: seven LLFF scenes, Train and Truck; F 0.2, 0.5, 0.8, A 0.5, 1; two rooms left out."""
    dataset = LIBRARY["dof-gaussian"]
    assert [scene.of for scene in dataset.scenes] == [
        *(f"llff/{name}" for name in ("fern", "flower", "fortress", "horns", "orchids", "room", "trex")),
        "tandt-db/train",
        "tandt-db/truck",
    ]
    assert (dataset.recipe.focus, dataset.recipe.aperture) == ((0.2, 0.5, 0.8), (0.5, 1.0))
    assert {left.scene for left in dataset.left_out} == {"llff/leaves", "tandt-db/drjohnson", "tandt-db/playroom"}
    said = {scene.of for scene in dataset.scenes} | {left.scene for left in dataset.left_out}
    assert said == {f"{other}/{scene.name}" for other in ("llff", "tandt-db") for scene in LIBRARY[other].scenes}
    # docs/published-methods.md, "Data sets": from the configurations of Deblur-NeRF and BAGS.
    held = {scene.name: scene.hold for scene in LIBRARY["deblur-nerf-real"].scenes}
    assert held == {
        "cake": 9,
        "caps": 5,
        "cisco": 7,
        "coral": 10,
        "cupcake": 6,
        "cups": 8,
        "daisy": 8,
        "sausage": 6,
        "seal": 6,
        "tools": 7,
    }
    synthetic = LIBRARY["deblur-nerf-synthetic"]
    assert (synthetic.hold, len(synthetic.scenes)) == (8, 5)


# ---- wrong files are one line ----


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("id = ", "no TOML"),
        (GOOD.replace('"small"', '"other"'), "id 'other', expected 'small'"),
        (GOOD.replace('"small"', '"Small set"'), "id: "),
        (GOOD.replace("title", "titel"), "titel"),
        (GOOD.replace('layout = "llff"', 'layout = "blender"'), "layout"),
        (GOOD.replace('layout = "llff"', ""), "no layout"),
        (GOOD.replace("{scene}", "../{scene}"), "leads out"),
        (GOOD.replace("{scene}", "/{scene}"), "leads out"),
        (GOOD.replace('folders = ["{scene}"]', ""), "one has no folders"),
        (GOOD + "views = 0", "scenes.0.views"),
        (GOOD.replace('role = "report"', 'role = "tuning"'), "role: Input should be 'development' or 'report'"),
        (GOOD + 'role = "test"', "scenes.0.role: Input should be 'development' or 'report'"),
        (GOOD.replace('role = "report"', ""), 'one has no role, expected role = "development" or role = "report"'),
        (GOOD + 'rendered = { recipe = "attic" }', "scenes.0.rendered.seed"),
        (GOOD.replace('role = "report"', 'marker = "x"').partition("[[scenes]]")[0], "no role, expected role"),
        (SCENE_ROLE + '[[scenes]]\nname = "two"\nof = "small/one"\nrole = "report"', "two is small/one"),
        (GOOD + "hold = 1", "scenes.0.hold"),
        (GOOD + 'sha256 = { "poses_bounds.npy" = "12" }', "sha256"),
        (GOOD + '[[scenes]]\nname = "one"', "two scenes of one name"),
        (GOOD + "[recipe]\nfocus = [0.2, 1.5]", "recipe.focus"),
        (GOOD + "[recipe]\naperture = [0.5, 0.5]", "every value once"),
        (GOOD + "[recipe]\nwidth = 0", "recipe.width"),
        (GOOD.replace("[[scenes]]", 'marker = "x"\n[[scenes]]'), "either scenes, or a marker"),
        (GOOD.partition("[[scenes]]")[0], "either scenes, or a marker"),
        (SCENE_ROLE + '[[scenes]]\nname = "two"\nof = "small/one"\nviews = 3', "two is small/one"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, text, found):
    assert tomllib.loads(GOOD)
    path = tmp_path / "small.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="small.toml: found ") as caught:
        read_library(tmp_path)
    assert found in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("target", ["nobody/one", "small/two", "again/one"])
def test_a_scene_of_another_dataset_must_be_there(tmp_path, target):
    again = 'id = "again"\ntitle = "A"\norigin = "o"\nlicence = "l"\n[[scenes]]\nname = "one"\nof = "{}"'
    (tmp_path / "small.toml").write_text(GOOD)
    (tmp_path / "again.toml").write_text(again.format("small/one"))
    library = read_library(tmp_path)
    dataset, scene = source_of(library, library["again"], library["again"].scenes[0])
    assert (dataset.id, scene.name) == ("small", "one")
    (tmp_path / "again.toml").write_text(again.format(target))
    with pytest.raises(InputError, match="again.toml: found one, of "):
        read_library(tmp_path)
