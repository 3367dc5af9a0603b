"""The result's schema: key, round trip, migration."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from relisted import edit_json, write_again
from tolerances import FLOAT64_VALUE

from dofbench.core.errors import InputError, Status
from dofbench.evaluation.results import result as module
from dofbench.evaluation.results.protocol import arithmetic_mean
from dofbench.evaluation.results.result import SCHEMA_VERSION, Result, Spec, read_result, write_result


def make_spec(**changes) -> Spec:
    values = {
        "method": "fake",
        "preset": "quick",
        "overrides": {},
        "options": {"noise": 0.1},
        "budget": "8it",
        "dataset": "waves",
        "dataset_checksum": "a" * 64,
        "protocol": "refocus-v1",
        "seed": 0,
        "device": "cpu",
        "code": "0.1.0+" + "b" * 64,
    }
    return Spec(**{**values, **changes})


def make_result(**changes) -> Result:
    spec = changes.pop("spec", make_spec())
    values = {
        "schema_version": 8,
        "key": spec.key,
        "spec": spec,
        "protocol": {},
        "plan": {"train_views": 2, "test_views": 1, "stages": []},
        "status": "ok",
        "message": "",
        "traceback": "",
        "scene": "waves",
        "data": "data",
        "data_from_here": "",
        "role": "report",
        "role_by": "report/attic",
        "photographer": "thinlens",
        "choices": "e" * 64,
        "command": "dofbench run --method fake",
        "started": "now",
        "ended": "then",
        "scores": {},
        "left_out": {},
        "left_out_stages": {},
        "do_nothing": {},
        "views": [],
        "lens": [],
        "fits": [],
        "apertures": [],
        "foci": [],
        "curve": [],
        "stages": {},
        "method_stages": {},
        "description": {},
        "nonfinite": [],
        "kernels_compiled": 0,
        "predictions": {},
        "model": {},
        "git": None,
        "machine": {"cpu": "a processor", "cores": 2, "memory_gib": 8.0, "os": "Linux", "python": "3.11.7"},
        "packages": {},
    }
    return Result(**{**values, **changes})


@pytest.mark.parametrize(
    "change",
    [
        {"method": "other"},
        {"preset": "slow"},
        {"overrides": {"noise": 0.2}},
        {"options": {"noise": 0.2}},
        {"budget": "9it"},
        {"dataset_checksum": "c" * 64},
        {"protocol": "sharp-inputs-v1"},
        {"seed": 1},
        {"device": "cuda"},
        {"code": "0.1.0+" + "d" * 64},
        {"dataset": "other"},
    ],
)
def test_the_key_depends_on_everything(change: dict) -> None:
    assert make_spec(**change).key != make_spec().key


def test_the_key_does_not_depend_on_the_order_of_options() -> None:
    assert make_spec(options={"a": 1, "b": 2}).key == make_spec(options={"b": 2, "a": 1}).key


def same(one: float, two: float) -> bool:
    return one == two or (math.isnan(one) and math.isnan(two))


@given(st.dictionaries(st.sampled_from(["psnr", "ssim", "delta_a"]), st.floats()))
def test_non_finite_numbers_survive(tmp_path_factory: pytest.TempPathFactory, scores: dict[str, float]) -> None:
    folder = tmp_path_factory.mktemp("result")
    write_result(folder, make_result(scores=scores))
    read = read_result(folder)
    assert read.scores.keys() == scores.keys()
    assert all(same(read.scores[column], value) for column, value in scores.items())


def test_a_result_reads_back(tmp_path: Path) -> None:
    git = {"commit": "e" * 40, "dirty": True}
    written = make_result(status=Status.DIVERGED, message="loss is nan at step 3", git=git)
    write_result(tmp_path, written)
    read = read_result(tmp_path)
    assert read.digest is not None and read.model_copy(update={"digest": None}) == written
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"plan": {}}, "plan"),
        ({"plan": {"train_views": 2, "test_views": 1, "stages": [{"name": "x"}]}}, "plan"),
        ({"machine": {}}, "machine"),
        ({"scores": {"train_s": math.nan}}, "train_s"),
        ({"scores": {"steps": math.inf}}, "steps"),
    ],
)
def test_what_a_report_cannot_show_is_named(tmp_path: Path, change: dict, named: str) -> None:
    write_result(tmp_path, make_result(**change))
    with pytest.raises(InputError, match=named):
        read_result(tmp_path)


def test_old_results_are_migrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_result(tmp_path, make_result())
    data = json.loads((tmp_path / "result.json").read_text())
    data["schema_version"] = -1
    del data["digest"]
    data["title"] = data.pop("command")
    write_again(tmp_path / "result.json", data)
    with pytest.raises(InputError, match="schema_version -1"):
        read_result(tmp_path)

    def rename(old: dict) -> dict:
        return {**{key: value for key, value in old.items() if key != "title"}, "command": old["title"]}

    monkeypatch.setattr(
        module,
        "MIGRATIONS",
        {-1: rename, 0: lambda data: {**data, "message": "migrated"}}
        | dict.fromkeys(range(1, SCHEMA_VERSION), lambda data: data),
    )
    assert read_result(tmp_path).command == "dofbench run --method fake"
    assert read_result(tmp_path).message == "migrated"


def test_fits_of_version_6_are_at_no_bound(tmp_path: Path) -> None:
    half = {"fitted_on": 1, "aperture": 3.0, "focus_disparity": 0.5, "sigma": 1.5, "renders": 30, "error": 0.01}
    data = make_result().model_dump(mode="json") | {"fits": [{"name": "v0", "seconds": 1.0, "halves": [half]}]}
    write_again(tmp_path / "result.json", data | {"schema_version": 6})
    (fit,) = read_result(tmp_path).fits
    assert fit.halves[0].model_dump() == half | {"at_bound": False}


@pytest.mark.parametrize("status", ["ok", "diverged", "crashed"])
def test_results_of_version_1_still_read(status: str) -> None:
    """Files written by the code of that schema version."""
    file = Path(__file__).parent / "old_results" / f"v1-{status}.json"
    old = json.loads(file.read_text())
    assert old["schema_version"] == 1
    result = read_result(file)
    assert result.schema_version == SCHEMA_VERSION and result.status == status and result.spec.key == result.key
    assert result.scores["train_s"] == old["scores"]["train_s"]
    assert result.scores["train_cpu_s"] == old["stages"]["train"]["cpu"]
    assert "cold_start_s" not in result.scores and "schema version 1" in result.left_out["cold_start_s"]
    assert [point.train_s for point in result.curve] == [point["train_s"] for point in old["curve"]]
    assert all(point.train_cpu_s is None for point in result.curve)
    assert result.model == {} and result.kernels_compiled is None
    assert result.fits == [] and result.apertures == [] and result.foci == []
    assert (result.role, result.role_by, result.photographer, result.choices) == (None, "", None, None)
    for column, value in old["scores"].items():
        assert same(result.scores[column], value)
    if status == "diverged":  # one value of its predictions is NaN, and so are its scores
        assert math.isnan(result.scores["psnr"]) and result.nonfinite


def test_a_result_of_version_3_states_no_role(tmp_path: Path) -> None:
    data = make_result().model_dump(mode="json")
    for added in ("role", "role_by", "photographer", "choices", "digest", "data_from_here"):
        del data[added]
    write_again(tmp_path / "result.json", data | {"schema_version": 3})
    result = read_result(tmp_path)
    assert (result.role, result.role_by, result.photographer, result.choices) == (None, "", None, None)
    write_again(tmp_path / "result.json", data | {"schema_version": 4})
    with pytest.raises(InputError, match="role: Field required"):
        read_result(tmp_path)


def test_what_a_migration_gives_is_of_this_version(tmp_path: Path) -> None:
    old = Path(__file__).parent / "old_results" / "v1-ok.json"
    write_result(tmp_path, read_result(old))
    assert read_result(tmp_path).model_copy(update={"digest": None}) == read_result(old)
    assert json.loads((tmp_path / "result.json").read_text())["schema_version"] == SCHEMA_VERSION


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "JSON"),
        ("[]", "no schema_version"),
        ("{}", "no schema_version"),
        ('{"schema_version": 9}', "newer dofbench"),
        ('{"schema_version": 8}', "changed after it was written"),
        ('{"schema_version": 5, "digest": null}', "changed after it was written"),
        ('{"schema_version": 5}', "key: Field required"),
        ('{"schema_version": 1}', "schema_version 1, and in it KeyError: 'stages'"),
        ("\xff", "UTF-8"),
    ],
)
def test_a_damaged_result_is_one_line(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "result.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=match):
        read_result(tmp_path)


def test_a_missing_result_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_result(tmp_path)


@given(st.lists(st.floats(), min_size=1, max_size=6))
@example([sys.float_info.max] * 3)
@example([sys.float_info.max] * 3 + [math.inf])
@example([math.inf] + [-sys.float_info.max] * 3 + [-math.inf])
def test_a_mean_leaves_no_value_out(values: list[float]) -> None:
    mean = arithmetic_mean(values)
    if any(math.isnan(value) for value in values) or {math.inf, -math.inf} <= set(values):
        assert math.isnan(mean)
    elif any(math.isinf(value) for value in values):
        assert mean in values and math.isinf(mean)
    else:
        assert math.isfinite(mean)
        assert min(values) <= mean <= max(values) or mean == pytest.approx(values[0], rel=FLOAT64_VALUE)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data["spec"].update(dataset="../../evil"),
        lambda data: data["spec"].update(method="a/b"),
        lambda data: data["spec"].update(preset=".."),
        lambda data: data["predictions"].update({"/etc/passwd": "0" * 64}),
        lambda data: data["model"].update({"model/../../x": "0" * 64}),
    ],
)
def test_names_that_lead_out_of_a_results_folder_are_refused(call, change):
    file = call().folder / "result.json"
    edit_json(file, change)
    with pytest.raises(InputError, match=r"result\.json"):
        read_result(file)
