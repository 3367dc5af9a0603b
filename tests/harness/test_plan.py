"""What a run decides before it starts."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from fake_method import write_method
from small_dataset import write_dataset

from dofbench.core.contracts import Decision
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.columns import lens_words
from dofbench.evaluation.results.protocol import (
    ACROSS_COLUMNS,
    DEPTH_COLUMNS,
    LENS_COLUMNS,
    PHOTOGRAPH_COLUMNS,
    PROTOCOLS,
    protocol_for,
)
from dofbench.methods.cards import find_method
from dofbench.methods.stages.facts import Facts
from dofbench.running.data_plan import DataPlan, Stage, decided, plan_for_data, revised


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods")))
    write_method(tmp_path / "methods", "pinhole", refocus=False, learns_lens=False)
    write_method(tmp_path / "methods", "pointless", needs_points=False)

    def plan(
        method: str = "fake",
        inputs: str = "shallow",
        overrides: dict | None = None,
        force_all: bool = False,
        blur: float | None = 4.0,
        dependence: float | None = 20.0,
        one_lens: bool | None = False,
        points: int = 900,
        spread: float | None = 20.0,
        light: float | None = None,
        f_numbers: bool = False,
        options: dict | None = None,
        **dataset,
    ) -> DataPlan:
        data = Dataset.load(write_dataset(tmp_path / "data", **dataset))
        facts = Facts(points, blur, dependence, one_lens, spread, light, f_numbers)
        return plan_for_data(
            find_method(method),
            options or {"noise": 0.2},
            overrides or {},
            data,
            facts,
            protocol_for(inputs),
            force_all=force_all,
        )

    return plan


def test_everything_runs_where_everything_is_needed(plan) -> None:
    made = plan()
    assert made.left_out == {}
    assert all(stage.runs for stage in made.stages)
    assert "psnr" in made.columns and "aif_flip" in made.columns and "delta_r" in made.columns
    assert made.options == {"noise": 0.2}


def test_a_method_without_a_lens_has_no_refocus_and_no_lens_errors(plan) -> None:
    made = plan("pinhole")
    assert made.left_out["psnr"] == "the method has no lens to refocus with"
    assert made.left_out["delta_a"] == "the method learns no lens"
    assert made.columns == ("aif_psnr", "aif_ssim", "aif_flip", "aif_ssim_uniform7", *DEPTH_COLUMNS)


def test_an_estimated_depth_is_no_truth(plan) -> None:
    made = plan(exact=False)
    assert not set(DEPTH_COLUMNS) & set(made.columns)
    assert {made.left_out[column] for column in DEPTH_COLUMNS} == {"the dataset's depth is an estimate"}


def test_the_plan_has_every_view_s_lens(plan) -> None:
    lenses = plan(assign="held-out").lenses
    assert lenses["assign"] == "held-out" and list(lenses["test"]) == ["v0", "v1"]
    assert lenses["train"]["v2"] == [0.5, 0.8]  # A, F


def _runs(made: DataPlan) -> dict[str, bool]:
    return {stage.name: stage.runs for stage in made.stages}


def test_a_needless_lens_is_left_out(plan) -> None:
    made = plan(blur=0.4)
    assert _runs(made)["lens"] is False and "lens_per_view" not in _runs(made)
    assert made.options == {"noise": 0.2, "lens": False}
    assert all("up to 0.40 px" in made.left_out[column] for column in LENS_COLUMNS)


@pytest.mark.parametrize("blur", [0.9, None])
def test_a_lens_runs_where_something_is_blurred_or_nothing_tells(plan, blur: float | None) -> None:
    assert _runs(plan(blur=blur))["lens"] and "lens" not in plan(blur=blur).options


def test_sharp_photographs_are_seen_as_such_and_not_told(plan) -> None:
    assert _runs(plan(inputs="all-in-focus", blur=4.0))["lens"]
    assert not _runs(plan(inputs="all-in-focus", blur=0.1))["lens"]


def test_one_lens_is_learned_where_the_dataset_says_so(plan) -> None:
    assert plan(one_lens=True).options["lens_per"] == "scene"
    assert "lens_per" not in plan(one_lens=False).options
    assert plan(one_lens=True, overrides={"lens_per": "view"}).options["lens_per"] == "view"
    assert "lens_per_view" not in _runs(plan(one_lens=True, overrides={"lens_per": "scene"}))  # nothing to decide


def test_what_only_goes_with_a_switch_decides_nothing(plan) -> None:
    """A lens that all photographs share starts wide open, unless the user says otherwise; it is shared all the same."""
    assert plan("lensselect", one_lens=True).options["lens_init_aperture"] == 1.5
    made = plan("lensselect", one_lens=True, overrides={"lens_init_aperture": 0.3})
    assert made.options["lens_per"] == "scene" and made.options["lens_init_aperture"] == 0.3
    assert "lens_init_aperture" not in plan("lensselect", one_lens=True, overrides={"lens_per": "view"}).options


TRIED = {"lens_trials": "lens,share,model"}


def test_what_nobody_knows_is_tried_while_training(plan) -> None:
    made = plan("lensselect", one_lens=None, blur=0.4, options=TRIED)
    assert all(_runs(made)[name] for name in ("lens", "lens_per_view", "aperture_per_view", "lens_samples"))
    assert "lens_trials" in made.options and made.options["lens_trials"] == "lens,share,model"
    reasons = {stage.name: stage.reason for stage in made.stages}
    assert all("tested during training" in reasons[name] for name in ("lens", "lens_per_view", "lens_samples"))


def test_what_is_known_is_not_tried(plan) -> None:
    assert plan("lensselect", one_lens=None, blur=4.0, options=TRIED).options["lens_trials"] == "share,model"
    assert plan("lensselect", one_lens=True, blur=4.0, options=TRIED).options["lens_trials"] == "model"
    assert plan("lensselect", one_lens=None, blur=0.4, options=TRIED, force_all=True).options["lens_trials"] == ""
    sharp = plan("lensselect", one_lens=None, blur=0.4, options=TRIED, inputs="all-in-focus")
    assert sharp.options["lens_trials"] == "" and not _runs(sharp)["lens"]
    assert plan("lensselect", one_lens=None, blur=1.4, options=TRIED, inputs="all-in-focus").options["lens_trials"]


def test_a_stage_that_cannot_be_left_out_says_what_the_data_show(plan, tmp_path: Path) -> None:
    card = tmp_path / "methods" / "fake" / "method.toml"
    card.write_text(card.read_text().replace('option = "lens"\noff = false\n', ""))
    stages = {stage.name: stage for stage in plan(blur=0.4).stages}
    assert stages["lens"].runs and stages["lens"].reason.startswith("fake can't disable it; ")
    card.write_text(card.read_text().replace('[stages.lens]\ndecided_by = "lens"\n', ""))
    assert "lens" not in _runs(plan(blur=0.4))  # not declared: nobody asks


def test_stages_may_stand_in_any_order(plan, tmp_path: Path) -> None:
    """What decides one may look at what was decided of another, whichever comes first in the card."""
    before = plan("pointless", points=0)
    card = tmp_path / "methods" / "pointless" / "method.toml"
    head, *stages = card.read_text().split("[stages.")
    last, claims = stages.pop().split("[claims]")
    card.write_text("[stages.".join([head, last, *reversed(stages)]) + "[claims]" + claims)
    after = plan("pointless", points=0)
    assert after.stages == before.stages and after.options == before.options and not _runs(after)["normals"]


def test_f_numbers_tie_apertures_where_the_user_does_not_say_otherwise(plan) -> None:
    tied = plan("lensselect", one_lens=None, f_numbers=True, options=TRIED)
    assert tied.options["lens_per"] == "exif" and "share" not in tied.options["lens_trials"]
    assert not _runs(tied)["aperture_per_view"] and "lens_per_view" not in _runs(tied)
    free = plan("lensselect", one_lens=None, f_numbers=True, options=TRIED, overrides={"lens_per": "view"})
    assert free.options["lens_per"] == "view" and "lens_init_aperture" not in free.options
    assert free.options["lens_trials"] == "model"  # what the user has decided isn't tried
    assert "lens_per" not in plan("lensselect", one_lens=False, f_numbers=True, options=TRIED).options


def test_what_training_decided_replaces_what_the_plan_left_open(plan) -> None:
    data = plan("lensselect", one_lens=None, blur=0.4, options=TRIED).as_data()
    after = revised(data, [Decision("lens", False, "tried: nothing gained")])
    stages = {stage["name"]: stage for stage in after["stages"]}
    assert stages["lens"] == {"name": "lens", "runs": False, "reason": "tried: nothing gained"}
    assert stages["lens_per_view"] in data["stages"] and len(stages) == len(data["stages"])
    more = revised(data, [Decision("early_stopping", True, "kept step 9")])["stages"]
    assert more == [*data["stages"], {"name": "early_stopping", "runs": True, "reason": "kept step 9"}]


def test_harmonics_are_left_out_of_a_scene_that_looks_alike_from_everywhere(plan) -> None:
    assert plan(dependence=1.0).options["harmonics"] == 0
    assert "harmonics" not in plan(dependence=4.0).options and "harmonics" not in plan(dependence=None).options


def test_colours_are_learned_where_points_or_else_exif_say_that_they_differ(plan) -> None:
    learned = [
        _runs(plan(spread=spread, light=light))["colours"]
        for spread, light in ((20.0, None), (1.0, None), (1.0, 2.0), (None, 2.0), (None, 0.1), (None, None))
    ]
    assert learned == [True, False, False, True, False, False]
    assert plan(spread=1.0).options["colours"] == 0 and "colours" not in plan(spread=1.0, force_all=True).options
    reason = next(stage.reason for stage in plan(spread=1.0).stages if stage.name == "colours")
    assert "differ by 1.0 %" in reason


def test_normals_need_depth_supervision(plan) -> None:
    sparing = "pointless"
    assert plan(sparing, points=0).options["normals"] == 0 and plan(sparing, points=0).options["depth"] == 0
    assert not {"normals", "depth"} & set(plan(sparing).options)
    forced = plan(sparing, points=0, force_all=True)
    assert not {"normals", "depth"} & set(forced.options) and all(_runs(forced).values())


def test_force_all_and_the_user_override_the_plan(plan) -> None:
    forced = plan(blur=0.4, force_all=True)
    assert "lens" not in forced.options and forced.left_out == {}
    assert plan(blur=0.4, overrides={"lens": True}).options["lens"] is True


def test_no_test_view_means_no_image_scores(plan) -> None:
    made = plan(test=0)
    assert made.columns == LENS_COLUMNS
    assert made.left_out["psnr"] == made.left_out["aif_psnr"] == "the dataset has no test views"
    assert made.left_out["depth_rel"] == "the dataset has no test views"


def test_sharp_inputs_have_no_lens_errors(plan) -> None:
    made = plan(inputs="all-in-focus")
    assert "sharp photographs" in made.left_out["delta_f"]


# ---- metrics without their truth: the fake dataset tests on v0 and v1, and trains on v2 to v5 ----

EVERY, TESTED, TRAINED = tuple(f"v{index}" for index in range(6)), ("v0", "v1"), ("v2", "v3", "v4", "v5")
REFOCUS = PROTOCOLS["refocus-v3"].refocus_columns
ALL_IN_FOCUS = PROTOCOLS["refocus-v3"].all_in_focus_columns


def test_photographs_of_unknown_lens_with_sharp_ones_to_test_with(plan) -> None:
    made = plan(unknown=EVERY, blurred=TRAINED, flat=EVERY, exact=False, one_lens=None)
    assert made.columns == ALL_IN_FOCUS
    assert {made.left_out[column] for column in REFOCUS} == {"no test lens"}
    assert {made.left_out[column] for column in LENS_COLUMNS} == {"no true lens"}
    assert {made.left_out[column] for column in DEPTH_COLUMNS} == {"no depth"}
    assert canonical_json(made.as_data())
    lines = made.lines()
    assert any(line.endswith("delta_a, delta_f, delta_r: no true lens") for line in lines)
    assert made.lenses == {"assign": "unknown", "train": dict.fromkeys(TRAINED), "test": dict.fromkeys(TESTED)}
    assert lens_words(made.lenses) == "trained on unknown lenses; no test lens"


@pytest.mark.parametrize(("blur", "runs"), [(4.0, True), (None, True), (0.4, False)])
def test_of_an_unknown_lens_the_photographs_tell_whether_it_is_needed(plan, blur: float | None, runs: bool) -> None:
    made = plan(unknown=EVERY, blurred=TRAINED, blur=blur, one_lens=None)
    assert _runs(made)["lens"] is runs and ("lens" in made.options) is not runs
    assert "lens_per" not in made.options and made.left_out["delta_a"] == "no true lens"
    if runs:
        (stage,) = (stage for stage in made.stages if stage.name == "lens_per_view")
        assert stage.runs and stage.reason == "no lens metadata"


def test_some_test_views_without_a_lens(plan) -> None:
    made = plan(unknown=("v1",))
    assert {made.left_out[column] for column in REFOCUS} == {"no test lens of 1 of 2 test views: v1"}
    assert made.left_out.keys() == set(REFOCUS)  # the rest has its truth
    assert lens_words(made.lenses).endswith("the test views ask for F 0.2 and A 0.5 (1 of 2 lenses unknown)")
    assert plan("pinhole", unknown=("v1",)).left_out["psnr"] == "the method has no lens to refocus with"


def test_no_test_view_with_a_lens(plan) -> None:
    made = plan(unknown=TESTED)
    assert made.left_out == dict.fromkeys(REFOCUS, "no test lens") and set(LENS_COLUMNS) <= set(made.columns)
    assert lens_words(made.lenses) == "trained on F 0.2, 0.5, 0.8 and A 0.5, 1; no test lens"


def test_training_views_without_a_lens(plan) -> None:
    made = plan(unknown=("v3", "v4"))
    assert {made.left_out[column] for column in LENS_COLUMNS} == {"no true lens of 2 of 4 training views: v3, v4"}
    assert made.left_out.keys() == set(LENS_COLUMNS)


def test_test_views_without_a_sharp_photograph_or_depth(plan) -> None:
    made = plan(blurred=("v0",), flat=("v0", "v1"))
    assert {made.left_out[column] for column in ALL_IN_FOCUS} == {"no sharp photograph of 1 of 2 test views: v0"}
    assert {made.left_out[column] for column in DEPTH_COLUMNS} == {"no depth"}
    assert plan(blurred=TRAINED, flat=TRAINED).left_out == {}  # those of the training views are no score's truth


def test_nothing_to_score_against(plan) -> None:
    made = plan(unknown=EVERY, blurred=EVERY, flat=EVERY)
    assert made.columns == () and "scores none" in made.lines()


@pytest.mark.parametrize("dataset", [{"points": 0}, {"train": 0}])
def test_what_a_method_cannot_do_without(plan, dataset: dict) -> None:
    with pytest.raises(InputError, match="dataset waves"):
        plan(**dataset)


def test_a_plan_is_plain_data_and_text(plan) -> None:
    made = plan("pinhole")
    assert canonical_json(made.as_data())
    text = "\n".join(made.lines())
    assert "no psnr, ssim, ms_ssim, flip, gmsd, delta_e, ssim_uniform7: the method has no lens to refocus with" in text


def test_every_protocol_is_found_by_its_inputs() -> None:
    newest = {protocol_for(inputs).id for inputs in ("shallow", "all-in-focus")}
    newest |= {protocol_for("shallow", photographs=columns).id for columns in (PHOTOGRAPH_COLUMNS, ACROSS_COLUMNS)}
    assert newest == {"refocus-v3", "sharp-inputs-v3", "photographs-v2", "across-apertures-v2"}
    assert newest < set(PROTOCOLS)  # the older ones are still known
    with pytest.raises(InputError, match="inputs"):
        protocol_for("blurry")


def test_what_training_decided_is_said_and_nothing_else():
    before = (Stage("lens", True, "tried while training"), Stage("harmonics", True, "they change"))
    plan = {"stages": [dataclasses.asdict(stage) for stage in before]}
    assert decided(before, plan) == []
    after = revised(plan, [Decision("lens", False, "0.1 px")])
    assert decided(before, after) == ["lens: off (0.1 px)"]
    # The same end for another reason is worth a line, too.
    assert decided(before, revised(plan, [Decision("lens", True, "+1 dB")])) == ["lens: on (+1 dB)"]
