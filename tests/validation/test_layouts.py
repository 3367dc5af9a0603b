"""Rendered scenes and BLB: read as they are written, and one clear line for what isn't."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE
from truth_fakes import looked_at

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.images import write_exr
from dofbench.evaluation.renderer.validate import cases_in
from dofbench.optics.tone import encode


@pytest.mark.slow
def test_a_scene_of_blb(blb):
    cases = cases_in(blb / "277")
    assert [(case.source, case.name, case.aperture, case.focus) for case in cases] == [
        ("BLB", "277", blur, distance) for blur in (4.0, 8.0) for distance in (1.0, 4.0)
    ]
    truth = cases[2].make()  # blur 8, focused at 1: the discs are sharp, the wall is 8 (1/4 - 1) behind
    pinhole, photograph, signed = looked_at(6.0, 1.0)
    assert np.abs(
        truth.signed_radius - signed
    ).max() < 6 * FLOAT32_SCALAR and truth.signed_radius.min() == pytest.approx(-6)
    assert np.abs(truth.sharp - encode(pinhole)).max() < FLOAT32_VALUE * pinhole.max()
    assert np.abs(truth.photograph - encode(np.clip(photograph, 0, 1))).max() < FLOAT32_VALUE
    assert truth.sharp.max() > 1 and math.isnan(truth.own_error_db)


def test_a_rendered_scene(rendered):
    cases = cases_in(rendered)
    assert [(case.source, case.name, case.view, case.aperture, case.focus) for case in cases] == [
        ("rendered", "walls", "000", 0.5, 1.0),
        ("rendered", "walls", "000", 0.5, 0.5),
    ]
    for case, focus in zip(cases, (1.0, 0.5), strict=True):
        truth, (pinhole, photograph, signed) = case.make(), looked_at(5.0, focus)
        # aperture_scene 10 px times units; disparities 1/2 and 0, so 5 px between them.
        assert np.abs(truth.signed_radius - signed).max() < 6 * FLOAT32_SCALAR
        assert np.abs(truth.sharp - encode(pinhole)).max() < FLOAT32_VALUE * pinhole.max()
        assert np.abs(truth.photograph - encode(np.clip(photograph, 0, 1))).max() < FLOAT32_VALUE
        assert truth.own_error_db == 52.5


def test_folders_of_them(blb, rendered, lightfield, tmp_path):
    assert len(cases_in(blb)) == 8 and len(cases_in(rendered.parent)) == 2
    sources = [case.source for case in cases_in(tmp_path)]
    assert sources == ["light field"] * 3  # nothing deeper than one level
    shutil.copytree(rendered, tmp_path / "walls")
    assert {case.source for case in cases_in(tmp_path)} == {"light field", "rendered"}


def test_what_a_photograph_is_made_of_is_in_its_key(rendered):
    before = {case.focus: case.key for case in cases_in(rendered)}
    write_exr(rendered / "lens" / "a_0.5.exr", np.zeros((120, 160, 3)))
    after = {case.focus: case.key for case in cases_in(rendered)}
    assert before[1.0] == after[1.0] and before[0.5] != after[0.5]
    scene = read_json(rendered / "scene.json")
    scene["lens_images"][0]["aperture_scene"] = 11.0
    write_json(rendered / "scene.json", scene)
    assert cases_in(rendered)[0].key != before[1.0]


def _scene(change):
    def damage(folder):
        scene = read_json(folder / "scene.json")
        change(scene)
        write_json(folder / "scene.json", scene)

    return damage


def _info(**values):
    return lambda folder: write_json(folder / "info.json", {**read_json(folder / "info.json"), **values})


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (_scene(lambda scene: scene.pop("lens_images")), "no lens_images"),
        (_scene(lambda scene: scene.update(lens_images=[])), "no photographs"),
        (_scene(lambda scene: scene["lens_images"][0].pop("focus_scene")), "without 'focus_scene'"),
        (_scene(lambda scene: scene.update(schema="another")), "no photographs"),
        (lambda folder: (folder / "lens" / "a_1.0.exr").unlink(), "a_1.0.exr: found nothing"),
        (lambda folder: (folder / "depth" / "000.exr").unlink(), "000.exr: found nothing"),
        (lambda folder: write_exr(folder / "depth" / "000.exr", np.full((120, 160), np.nan)), "not finite"),
        (lambda folder: write_exr(folder / "depth" / "000.exr", np.full((9, 12), 1.0)), r"\(9, 12\)"),
        (lambda folder: (folder / "lens" / "a_1.0.exr").write_bytes(b"EXR"), "no readable image"),
        (lambda folder: (folder / "scene.json").write_text("{"), "no JSON"),
    ],
)
def test_a_rendered_scene_that_is_damaged(rendered, damage, word):
    damage(rendered)
    with pytest.raises(InputError, match=word) as caught:
        [case.make() for case in cases_in(rendered)]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (_info(focus_distances=[]), "focus_distances"),
        (_info(blur_parameters=[4.0, -1.0]), "blur_parameters"),
        (_info(blur_parameters=[4.0]), "level 1, focus 0"),
        (lambda folder: (folder / "image.exr").unlink(), "image.exr: found nothing"),
        (lambda folder: [file.unlink() for file in folder.glob("bokeh_*.exr")], "no bokeh_KK_FF.exr"),
        (lambda folder: write_exr(folder / "depth.exr", np.zeros((120, 160))), "isn't positive"),
        (lambda folder: write_exr(folder / "bokeh_00_00.exr", np.zeros((9, 12, 3))), "12 x 9"),
        (lambda folder: (folder / "info.json").unlink(), "no photographs"),
    ],
)
def test_a_scene_of_blb_that_is_damaged(blb, damage, word):
    damage(blb / "277")
    with pytest.raises(InputError, match=word) as caught:
        [case.make() for case in cases_in(blb / "277")]
    assert "\n" not in str(caught.value)


def test_no_folder_and_an_empty_one(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        cases_in(tmp_path / "nowhere")
    with pytest.raises(InputError, match="scene.json"):
        cases_in(tmp_path)
