"""What a run decides before it starts."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness_fakes import FakeDataset, write_dataset, write_method

from dofbench.contracts import Budget
from dofbench.errors import InputError
from dofbench.files import canonical_json
from dofbench.harness.methods import find_method
from dofbench.harness.plan import RunPlan, make_plan
from dofbench.harness.protocol import DEPTH_COLUMNS, LENS_COLUMNS, PROTOCOLS, protocol_for


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods")))
    write_method(tmp_path / "methods", "pinhole", refocus=False, learns_lens=False)

    def plan(method: str = "fake", inputs: str = "shallow", overrides: dict | None = None, force_all: bool = False,
             **dataset) -> RunPlan:
        data = FakeDataset(write_dataset(tmp_path / "data", **dataset))
        return make_plan(find_method(method), "quick", {"noise": 0.2}, overrides or {}, Budget(steps=8), data,
                         protocol_for(inputs), seed=0, device="cpu", force_all=force_all)

    return plan


def test_everything_runs_where_everything_is_needed(plan) -> None:
    made = plan()
    assert made.left_out == {}
    assert all(stage.runs for stage in made.stages)
    assert "psnr" in made.columns and "aif_flip" in made.columns and "delta_r" in made.columns
    assert made.options == {"noise": 0.2}


def test_a_method_without_a_lens_has_no_refocus_and_no_lens_errors(plan) -> None:
    made = plan("pinhole")
    assert made.left_out["psnr"] == "Pinhole has no lens to refocus with"
    assert made.left_out["delta_a"] == "Pinhole learns no lens"
    assert made.columns == ("aif_psnr", "aif_ssim", "aif_flip", *DEPTH_COLUMNS)


def test_an_estimated_depth_is_no_truth(plan) -> None:
    made = plan(exact=False)
    assert not set(DEPTH_COLUMNS) & set(made.columns)
    assert {made.left_out[column] for column in DEPTH_COLUMNS} == {
        "the dataset's own depth is an estimate, no truth to compare with"}


def test_the_plan_has_every_view_s_lens(plan) -> None:
    lenses = plan(assign="held-out").lenses
    assert lenses["assign"] == "held-out" and list(lenses["test"]) == ["v0", "v1"]
    assert lenses["train"]["v2"] == [0.5, 0.8]  # A, F


def test_a_needless_lens_is_left_out(plan) -> None:
    made = plan(coc=0.4)
    assert [stage.runs for stage in made.stages if stage.name == "lens"] == [False]
    assert made.options == {"noise": 0.2, "lens": False}
    assert all("0.40 px, below 0.5 px" in made.left_out[column] for column in LENS_COLUMNS)


def test_force_all_and_the_user_override_the_plan(plan) -> None:
    forced = plan(coc=0.4, force_all=True)
    assert "lens" not in forced.options and forced.left_out == {}
    assert plan(coc=0.4, overrides={"lens": True}).options["lens"] is True


def test_no_test_view_means_no_image_scores(plan) -> None:
    made = plan(test=0)
    assert made.columns == LENS_COLUMNS
    assert made.left_out["psnr"] == made.left_out["aif_psnr"] == "the dataset has no test views"
    assert made.left_out["depth_rel"] == "the dataset has no test views"


def test_sharp_inputs_have_no_lens_errors(plan) -> None:
    made = plan(inputs="all-in-focus")
    assert made.protocol == "sharp-inputs-v2"
    assert "sharp photographs" in made.left_out["delta_f"]
    assert made.largest_coc_px == 0


@pytest.mark.parametrize("dataset", [{"points": False}, {"train": 0}])
def test_what_a_method_cannot_do_without(plan, dataset: dict) -> None:
    with pytest.raises(InputError, match="dataset waves"):
        plan(**dataset)


def test_a_plan_is_plain_data_and_text(plan) -> None:
    made = plan("pinhole")
    assert canonical_json(made.as_data())
    text = "\n".join(made.lines())
    assert "no psnr, ssim, ms_ssim, flip, gmsd, delta_e: Pinhole has no lens to refocus with" in text


def test_every_protocol_is_found_by_its_inputs() -> None:
    newest = {protocol_for(protocol.inputs).id for protocol in PROTOCOLS.values()}
    assert newest == {"refocus-v2", "sharp-inputs-v2"} < set(PROTOCOLS)  # the older ones are still known
    with pytest.raises(InputError, match="inputs"):
        protocol_for("blurry")
