"""Roles of scenes: every scene has one, and a folder's scene is recognised by name, recipe and seed, or checksums."""

from __future__ import annotations

import json
import shlex
import shutil

import pytest

from dofbench.cli import app
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.scenes.named import named_datasets, resolve
from dofbench.scenes.named.library import StatedRole, contradiction, role_of_recipe, role_of_scene
from dofbench.scenes.procedural.scene_options import DEVELOPMENT, NAMES, REPORT, MakeScene

LIBRARY = named_datasets()
# What was looked at before roles were stated; nothing is ever taken away from this list.
LOOKED_AT = {
    "tabletop/tabletop",
    "thinlens/fence",
    "thinlens/foliage",
    "thinlens/night",
    "llff/fern",
    "llff/flower",
    "dof-gaussian/fern",
    "dof-gaussian/flower",
    "real-lens/blowtorch",
    "real-lens/chessking",
    "instant-ngp/fox",
    "light-field/chess",
    "light-field/desk",
}


def scene_json(folder, recipe, seed):
    folder.mkdir(parents=True)
    made = {"schema": "dofbench-scene", "recipe": recipe, "seed": seed, "licence": "CC0-1.0"}
    (folder / "scene.json").write_text(json.dumps(made))
    return folder


def test_every_scene_has_a_role_and_what_was_looked_at_is_for_development():
    roles = {
        f"{dataset.id}/{scene.name}": role_of_scene(LIBRARY, dataset, scene)
        for dataset in LIBRARY.values()
        for scene in dataset.scenes
    }
    assert {label for label, stated in roles.items() if stated and stated.role == "development"} == LOOKED_AT
    assert None not in roles.values()
    assert {"llff/horns", "tandt-db/truck", "deblur-nerf-real/seal", "real/room", "real/vases", "vr-project/desk"} <= {
        label for label, stated in roles.items() if stated and stated.role == "report"
    }
    assert roles["dof-gaussian/room"] == StatedRole("report", "llff/room")


def test_recipes_are_of_one_role_each():
    """`make-scene all` makes those for development, and a report scene is one recipe with one seed."""
    assert set(LIBRARY["rendered"].recipes) == set(DEVELOPMENT) and LIBRARY["rendered"].role == "development"
    report = {scene.rendered.recipe: scene.rendered.seed for scene in LIBRARY["report"].scenes if scene.rendered}
    assert set(report) == set(REPORT) and len(set(report.values())) == len(REPORT) >= 6
    assert sorted((*DEVELOPMENT, *REPORT)) == list(NAMES)
    assert MakeScene("all").recipes == DEVELOPMENT


@pytest.mark.parametrize("scene", LIBRARY["report"].scenes, ids=lambda scene: scene.name)
def test_the_command_of_a_report_scene_makes_it(scene):
    command = shlex.split(scene.made_by)
    assert command[0] == "dofbench"
    settings = app.parse(command[1:])
    assert isinstance(settings, MakeScene)
    assert (settings.recipe, settings.seed) == (scene.rendered.recipe, scene.rendered.seed)
    assert ((settings.width, settings.height), settings.views) == (scene.size, scene.views)
    assert (settings.samples, settings.lens_views) == (256, 0)


@pytest.mark.parametrize(
    ("recipe", "seed", "role"),
    [
        ("corridor", 0, StatedRole("development", "rendered")),
        ("corridor", 20261104, StatedRole("development", "rendered")),
        ("attic", 20261104, StatedRole("report", "report/attic")),
        ("attic", 0, None),
        ("spokes", 20261104, None),
        ("beach", 0, None),
        (None, None, None),
    ],
)
def test_a_rendered_scene_by_recipe_and_seed(tmp_path, recipe, seed, role):
    assert role_of_recipe(recipe, seed) == role
    (scene,) = resolve(str(scene_json(tmp_path / "mine", recipe, seed)), None)
    assert (scene.role, scene.role_by) == ((role.role, role.by) if role else (None, ""))


def test_a_scene_by_name_and_by_its_path(tmp_path):
    for place in ("llff_room", "nerf_llff_data/leaves", "shallow_chessking", "report/vr_desk", "somebody/desk"):
        (tmp_path / place).mkdir(parents=True)
    by_name = resolve("dof-gaussian/room", tmp_path)[0]
    assert (by_name.role, by_name.role_by) == ("report", "llff/room")
    found = {path: resolve(str(tmp_path / path), None)[0].role for path in ("llff_room", "shallow_chessking")}
    assert found == {"llff_room": "report", "shallow_chessking": "development"}
    assert resolve(str(tmp_path / "report" / "vr_desk"), None)[0].role_by == "vr-project/desk"
    assert resolve(str(tmp_path / "somebody" / "desk"), None)[0].role is None


def test_a_copy_under_another_name_by_its_checksums(tmp_path):
    copy = tmp_path / "my own scene"
    copy.mkdir()
    shutil.copy(content_folder("datasets") / "tabletop" / "SHA256SUMS", copy)
    (scene,) = resolve(str(copy), None)
    assert (scene.role, scene.role_by, scene.dataset) == ("development", "tabletop/tabletop", None)
    (copy / "SHA256SUMS").write_text("other")
    assert resolve(str(copy), None)[0].role is None


def test_another_seed_is_not_the_report_scene(tmp_path):
    scene_json(tmp_path / "report" / "attic", "attic", 0)
    with pytest.raises(InputError, match="holds a scene of another recipe or seed") as caught:
        resolve("report/attic", tmp_path)
    assert "dofbench make-scene attic --seed 20261104" in str(caught.value)
    (tmp_path / "report" / "attic" / "scene.json").unlink()
    (tmp_path / "report" / "attic").rmdir()
    scene_json(tmp_path / "report" / "attic", "attic", 20261104)
    assert resolve("report/attic", tmp_path)[0].role == "report"


@pytest.mark.parametrize(
    ("role", "by", "said"),
    [
        ("development", "llff/fern", ""),
        ("report", "llff/fern", "datasets/llff.toml says development of llff/fern"),
        ("development", "dof-gaussian/room", "says report of dof-gaussian/room"),
        ("report", "llff/garden", "says nothing of llff/garden"),
        ("report", "nobody/fern", "no named dataset"),
        ("report", "", "stated by nothing"),
        ("report", "dof-nerf/amiya", ""),
        ("development", "rendered", ""),
        ("report", "rendered", "says development of rendered"),
        (None, "", ""),
        (None, "llff/fern", "role not stated, and yet by llff/fern"),
    ],
)
def test_a_recorded_role_is_compared_with_the_files(role, by, said):
    assert (said in contradiction(role, by)) if said else contradiction(role, by) == ""
