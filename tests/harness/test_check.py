"""`dofbench check` on results: a good one passes, every kind of tampering is named."""

from __future__ import annotations

import io
import json
import math
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_method import fake_run
from relisted import edit_json
from rich.console import Console

from dofbench.cli import app
from dofbench.cli.check import Verdict, check
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_image, write_png
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.evaluation.scoring.result_consistency import inconsistencies
from dofbench.running.check_results import check_result
from dofbench.running.rescore import score


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One good run."""
    with pytest.MonkeyPatch.context() as patch:
        return fake_run(tmp_path_factory.mktemp("original"), patch)().folder


@pytest.fixture
def folder(call, original: Path, tmp_path: Path) -> Path:
    """Its result, to be damaged."""
    return shutil.copytree(original, tmp_path / "results" / "waves" / original.name)


def edit(folder: Path, change: Callable[[dict], None]) -> None:
    edit_json(folder / "result.json", change)


def test_a_good_result_passes(folder: Path) -> None:
    assert check_result(folder).problems == []
    assert check(folder.parent.parent, Console(quiet=True))


@pytest.mark.parametrize("status", ["lost", "crash"])
def test_a_failed_result_can_be_a_good_one(call, status: str) -> None:
    assert check_result(call(set=(f"trouble={status}",)).folder).problems == []


def test_results_of_version_1_agree_with_themselves() -> None:
    for status in ("ok", "diverged", "crashed"):
        assert inconsistencies(read_result(Path(__file__).parent / "old_results" / f"v1-{status}.json")) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: data["spec"].update(seed=5), "the key is"),
        (lambda data: data["plan"].update(seed=5), "the plan's seed is 5, the spec's 0"),  # older results have both
        (lambda data: data["protocol"].update(levels=16), "protocol refocus-v3: its levels is not"),
        (lambda data: data["left_out"].update(psnr="why"), "psnr: a score, and a reason why there is none"),
        (lambda data: data["left_out"].update(lpips=" "), "lpips: skipped without a reason"),
        (lambda data: data["left_out_stages"].update(normals=""), "normals: skipped without a reason"),
        (
            lambda data: [view["scores"].pop("ssim") for view in data["views"]] and data["scores"].pop("ssim"),
            "no score ssim, though the plan has it",
        ),
        (lambda data: data["views"][1]["scores"].pop("ssim"), "ssim: not of every view"),
        (lambda data: [view["scores"].pop("ssim") for view in data["views"]], "ssim: a mean without per-view values"),
        (lambda data: data["lens"][0].update(focus_estimated=9.0), "view v2: delta_f is"),
        (lambda data: data["lens"][0].update(name="v9"), "view v9: another true lens than the plan's"),
        (lambda data: data["views"][0].update(name="v9"), "scores of other views than the plan's test views"),
        (lambda data: data["views"][0]["scores"].update(ssim=math.nan), "view v0: ssim is nan, and the run ended ok"),
        (
            lambda data: data["nonfinite"].append({"step": 1, "view": "", "stage": "loss", "detail": "loss is inf"}),
            "loss: loss is inf, and the run ended ok",
        ),
        (lambda data: data.update(status="crashed", message=""), "ended crashed without a message"),
        (lambda data: data.update(status="diverged", message="?"), "ended diverged, with scores all the same"),
        (lambda data: data["scores"].update(train_s=0.001), "train_s is 0.001, its stages took"),
        (lambda data: data["scores"].update(train_cpu_s=77.0), "train_cpu_s is 77, its stages took"),
        (lambda data: data["scores"].update(cold_start_s=0.0), "cold_start_s is 0, its stages took"),
        (lambda data: data["stages"]["score"].update(wall=-1.0), "stages.score.wall"),
        (lambda data: data["stages"]["score"].update(cpu=math.nan), "stages.score.cpu"),
        (lambda data: data["curve"].reverse(), "the curve goes back"),
        (lambda data: data["curve"][-1].update(train_s=1e6), "the curve goes on after the end of training"),
        (lambda data: data["curve"].pop(), "the curve ends at step"),
        (
            lambda data: data["predictions"].pop("predictions/refocus/v0.png"),
            "view v0: scores of refocus, and no picture of it",
        ),
        (lambda data: data["model"].update({"model/model.json": "0"}), "model/model.json: not the file"),
        (lambda data: data["model"].update({"model/more.json": "0"}), "model/more.json: missing"),
        (lambda data: data["spec"].update(protocol="own-v1"), "unknown protocol 'own-v1'"),
        (lambda data: data["scores"].update(psnr=99.0), "psnr: 99 is not the mean"),
        (lambda data: data["scores"].update(delta_a=0.0), "delta_a: 0 is not the mean"),
        (lambda data: data["scores"].pop("flip"), "flip: no mean"),
        (lambda data: data.pop("machine"), "machine: Field required"),
        (lambda data: data["predictions"].update({"../../x.png": "0"}), "a path with .."),
    ],
)
def test_tampering_with_the_result_is_named(folder: Path, change: Callable, problem: str) -> None:
    edit(folder, change)
    assert any(problem in line for line in check_result(folder).problems)


def test_a_lost_value_without_an_event_is_named(call) -> None:
    folder = call(set=("trouble=hole",)).folder
    assert check_result(folder).problems == []
    edit(folder, lambda data: data["nonfinite"].clear())
    assert any("is nan, and no event says so" in line for line in check_result(folder).problems)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: data["scores"]["aif_gmsd"].update(value=0.5), "added aif_gmsd: 0.5 is not the mean"),
        (lambda data: data["scores"]["aif_gmsd"]["views"].pop("v0"), "added aif_gmsd: its views aren't"),
        (lambda data: data["scores"].update(psnr=data["scores"]["aif_gmsd"]), "added psnr: the result itself has"),
        (lambda data: data["scores"].update(lpips=data["scores"]["aif_gmsd"]), "added lpips: no such metric"),
        (lambda data: data["scores"].update(lpips_alex=data["scores"]["aif_gmsd"]), "added lpips_alex: no sha256 of"),
        (lambda data: data.update(key="0" * 64), "added scores of the key 00000000"),
        (lambda data: data.update(result_sha256="0" * 64), "scores of another result.json"),
        (lambda data: data.update(schema_version=9), "found schema_version 9"),
        (lambda data: data["scores"]["aif_gmsd"].pop("code"), "scores.aif_gmsd.code: Field required"),
    ],
)
def test_tampering_with_added_scores_is_named(folder: Path, change: Callable, problem: str) -> None:
    score([folder], "aif_gmsd", console=Console(quiet=True))
    assert check_result(folder).problems == []
    data = json.loads((folder / "added.json").read_text())
    change(data)
    (folder / "added.json").write_text(json.dumps(data))
    assert any(problem in line for line in check_result(folder).problems)


def said_of(folder: Path) -> tuple[bool, str]:
    stream = io.StringIO()
    good = check(folder, Console(file=stream, width=400))
    return good, stream.getvalue()


def test_what_dead_processes_leave_is_named(folder: Path) -> None:
    spec = read_result(folder).spec.model_copy(update={"seed": 7})
    (folder / "trained.json").write_text("{}")
    (folder / "predictions" / ".dofbench-v0.abc.png").touch()
    dead = folder.parent / "dead"
    with run_lock(dead, spec, "waves", "noon"):
        lock = (dead / "running.lock").read_bytes()
        assert "a run is at work there, not checked" in said_of(folder.parent)[1]
    (dead / "running.lock").write_bytes(lock)
    good, said = said_of(folder.parent)
    assert not good and f"{dead}: a run died here" in said
    assert "trained.json: left by a run" in said and "predictions/.dofbench-v0.abc.png: half a file" in said


def test_a_folder_of_another_name_and_a_result_twice_are_named(folder: Path) -> None:
    copy = folder.parent / "backup"
    shutil.copytree(folder, copy)
    assert check_result(copy).problems == [f"the folder of this run would be {folder.name}: it is found by its name"]
    shutil.copytree(folder, folder.parent.parent / "again" / folder.name)
    good, said = said_of(folder.parent.parent)
    assert not good and "the same run as in" in said


def test_another_picture_is_named(folder: Path) -> None:
    picture = folder / "predictions" / "refocus" / "v0.png"
    write_png(picture, read_image(picture) * 0.5)
    assert check_result(folder).problems == [
        "predictions/refocus/v0.png: not the file that was scored (its sha256 is another one)"
    ]
    picture.unlink()
    assert check_result(folder).problems == ["predictions/refocus/v0.png: missing"]


def test_a_picture_with_a_forged_checksum_has_another_score(folder: Path) -> None:
    picture = folder / "predictions" / "refocus" / "v0.png"
    write_png(picture, read_image(picture) * 0.5)
    edit(folder, lambda data: data["predictions"].update({"predictions/refocus/v0.png": sha256_file(picture)}))
    problem = check_result(folder).problems[0]
    assert "view v0: psnr is" in problem and "computed again" in problem


def test_problems_are_printed(folder: Path) -> None:
    edit(folder, lambda data: data["spec"].update(seed=5))
    stream = io.StringIO()
    assert not check(folder / "result.json", Console(file=stream, width=200))
    assert f"{folder}: the key is" in stream.getvalue()


def test_nothing_to_check_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither dataset.json nor result.json"):
        check(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        check(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"role": "report"}, "role report, stated by nothing, which is no named dataset"),
        (
            {"role": "report", "role_by": "llff/fern"},
            "role report, and datasets/llff.toml says development of llff/fern",
        ),
        ({"role": "report", "role_by": "llff/room"}, "role report, and None of "),
        ({"photographer": "thinlens"}, "photographer thinlens, and scatter of "),
    ],
)
def test_another_role_or_photographer_than_the_dataset_s_is_named(folder: Path, change: dict, said: str) -> None:
    edit(folder, lambda data: data.update(change))
    assert any(problem.startswith(said) for problem in check_result(folder).problems)


def test_a_result_of_an_older_version_states_neither(folder: Path) -> None:
    edit(folder, lambda data: data.update(role=None, role_by="", photographer=None, choices=None))
    assert check_result(folder).problems == []


# ---- every change is noticed ----


def test_random_bits_of_a_result(folder: Path) -> None:
    """`check` names every one of them, as a change or as what it made of the file."""
    file = folder / "result.json"
    whole, generator = file.read_bytes(), random.Random(48)
    for _ in range(200):
        place, bit = generator.randrange(len(whole)), 1 << generator.randrange(8)
        file.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        with pytest.raises(InputError):
            read_result(file)
    file.write_bytes(whole)
    assert check_result(folder).problems == []


def test_a_result_without_its_digest(folder: Path) -> None:
    edit(folder, lambda data: data.pop("digest"))
    assert "changed after it was written" in check_result(folder).problems[0]


def test_an_older_result_without_a_digest_is_good_and_said_to_be(folder: Path) -> None:
    edit(folder, lambda data: (data.pop("digest"), data.pop("data_from_here"), data.update(schema_version=5)))
    good, said = said_of(folder)
    assert good and "good, of an older version without a digest of its own" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: shifted(data, "ssim"), "view v0: ssim is"),
        (lambda data: shifted(data, "aif_flip"), "view v0: aif_flip is"),
        (lambda data: shifted(data, "delta_e"), "view v0: delta_e is"),
        (lambda data: data["lens"][0].update(delta_r=0.0), "delta_r is 0, computed again"),
        (lambda data: data["scores"].update(delta_r=0.0), "delta_r is 0, computed again"),
        (lambda data: data["do_nothing"].update(delta_f=0.9), "do_nothing delta_f is 0.9, computed again"),
        (lambda data: data["curve"][-1]["scores"].update(psnr=99.0), "psnr is "),
        (lambda data: data.update(scene="elsewhere"), "scene elsewhere, and waves of"),
    ],
)
def test_scores_that_agree_with_each_other_are_computed_again(folder: Path, change: Callable, said: str) -> None:
    edit(folder, change)
    assert any(said in problem for problem in check_result(folder).problems)


def shifted(data: dict, column: str) -> None:
    """A better score of one view, and the mean that goes with it."""
    data["views"][0]["scores"][column] += 0.1
    data["scores"][column] = math.fsum(view["scores"][column] for view in data["views"]) / len(data["views"])


# ---- where the dataset is ----


def test_the_dataset_is_found_from_another_folder(
    folder: Path, original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By where it is relative to the result, and beside a folder above; else scores aren't computed again, and that is
    said."""
    (data,) = [path for path in original.parents if (path / "data" / "dataset.json").is_file()]
    monkeypatch.chdir(tmp_path)
    edit(folder, lambda content: content.update(data="elsewhere/data", data_from_here=""))
    assert check(folder) is Verdict.NOT_RECOMPUTED
    assert "scores not recomputed (elsewhere/data: found no dataset there" in said_of(folder)[1]
    assert app.main(["check", str(folder)]) == app.NOT_RECOMPUTED == 3
    assert app.main(["check", str(folder), "--data", str(data / "data")]) == app.DONE
    shutil.copytree(data / "data", tmp_path / "waves")
    assert check(folder) is Verdict.GOOD
    (tmp_path / "waves").rename(tmp_path / "renamed")
    assert check(folder) is Verdict.NOT_RECOMPUTED
    edit(folder, lambda content: content.update(data_from_here="../../../renamed"))
    assert check(folder) is Verdict.GOOD


def test_a_dataset_that_changed_gives_no_scores(folder: Path, tmp_path: Path, original: Path) -> None:
    (data,) = [path / "data" for path in original.parents if (path / "data" / "dataset.json").is_file()]
    copy = shutil.copytree(data, tmp_path / "copy")
    shutil.copyfile(copy / "images" / "v1.png", copy / "images" / "v0.png")
    checked = check_result(folder, copy)
    assert checked.problems == [] and "v0.png: found a changed file" in checked.not_recomputed
