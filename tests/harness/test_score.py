"""Rescoring finished runs: scores that are added, scores that must come out the same, and scores skipped with the
reason."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_method import fake_run
from lpips_weights import write_weights
from relisted import write_again
from rich.console import Console
from small_dataset import write_dataset

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_image, write_png
from dofbench.evaluation.metrics import METRICS, Metric
from dofbench.evaluation.metrics.lpips import load_lpips
from dofbench.evaluation.results.added_scores import read_added
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.protocol import DEPTH_COLUMNS
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.reporting import report_files
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report
from dofbench.running.check_results import check_result
from dofbench.running.load_run import load_run
from dofbench.running.rescore import columns_known, score, score_result


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    return fake_run(tmp_path, monkeypatch)


def scored(path: Path, metrics: str | None = None, **more) -> tuple[bool, str]:
    stream = io.StringIO()
    good = score([path], metrics, console=Console(file=stream, width=400), **more)
    return good, stream.getvalue()


def worst_error(prediction: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(prediction.astype(np.float64) - truth).max())


@pytest.fixture
def worst(monkeypatch: pytest.MonkeyPatch) -> None:
    """A metric that didn't exist when the runs were made."""
    metric = Metric("worst", "worst error", "", False, 0.0, 1.0, "images", worst_error, "largest absolute error")
    monkeypatch.setitem(METRICS, "worst", metric)


def forbid_training(folder: Path) -> None:
    code = folder / "methods" / "fake" / "trainer.py"
    code.write_text(
        code.read_text().replace(
            "    def fit(self, training_set, budget, observer):\n",
            "    def fit(self, training_set, budget, observer):\n        1 / 0\n",
        )
    )


def test_a_new_metric_is_added_without_training(call, worst, tmp_path: Path) -> None:
    end = call()
    before = (end.folder / "result.json").read_bytes()
    forbid_training(tmp_path)
    good, said = scored(tmp_path / "results", "worst,aif_worst")
    assert good and "added worst" in said and "of 2 views, from the kept predictions" in said
    assert (end.folder / "result.json").read_bytes() == before
    added, run = read_added(end.folder), load_run(end.folder)
    result, data = run.result, run.dataset
    assert set(added.scores) == {"worst", "aif_worst"} and added.key == result.key
    for kind, column, read in (("refocus", "worst", data.image), ("all_in_focus", "aif_worst", data.all_in_focus)):
        values = {
            view.name: worst_error(read_image(end.folder / "predictions" / kind / f"{view.name}.png"), read(view))
            for view in data.test_views()
        }
        assert added.scores[column].views == values
        assert added.scores[column].value == pytest.approx(np.mean(list(values.values())))
    # The versions of the code that trained and of the code that scored are both recorded.
    assert added.scores["worst"].code != result.spec.code and added.scores["worst"].note == "largest absolute error"


def test_all_there_is(call) -> None:
    end = call()
    good, said = scored(end.folder)
    result, added = read_result(end.folder), read_added(end.folder)
    assert good
    (line,) = [line for line in said.splitlines() if "the same again" in line]
    assert set(line.split("again: ")[1].split(", ")) == set(columns_known()) & set(result.scores)
    assert set(DEPTH_COLUMNS) <= set(result.scores)  # of the model, rendered again
    assert set(added.scores) == set(columns_known()) - set(result.scores) >= {"aif_ms_ssim", "aif_gmsd"}
    assert scored(end.folder)[0] and read_added(end.folder).scores.keys() == added.scores.keys()


def test_what_a_run_kept_of_depth_is_scored_by_its_model(call, tmp_path: Path) -> None:
    """A result from before there were errors of depth."""
    end = call()
    data = json.loads((end.folder / "result.json").read_text())
    expected = {column: data["scores"].pop(column) for column in DEPTH_COLUMNS}
    write_again(end.folder / "result.json", data)
    good, said = scored(end.folder, "depth_rel,disparity_error")
    assert good and "from the kept model" in said
    assert {column: one.value for column, one in read_added(end.folder).scores.items()} == pytest.approx(expected)


def test_the_authors_ssim_is_added_to_a_result_of_an_older_protocol(call) -> None:
    end = call()
    data = json.loads((end.folder / "result.json").read_text())
    assert data["protocol"]["id"] == "refocus-v3"
    expected = {column: data["scores"].pop(column) for column in ("ssim_uniform7", "aif_ssim_uniform7")}
    data["protocol"]["id"] = data["plan"]["protocol"] = data["spec"]["protocol"] = "refocus-v2"
    for metrics in ("refocus", "all_in_focus"):
        data["protocol"][metrics].remove("ssim_uniform7")
    write_again(end.folder / "result.json", data)
    assert scored(end.folder, "ssim_uniform7,aif_ssim_uniform7")[0]
    assert {column: one.value for column, one in read_added(end.folder).scores.items()} == pytest.approx(expected)
    assert expected["ssim_uniform7"] != data["scores"]["ssim"]  # another metric than ours


def test_without_a_truth_it_is_left_out_with_the_reason(call, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", exact=False)
    end = call(method="pinhole")
    good, said = scored(end.folder, "depth_rel,ms_ssim,aif_ms_ssim")
    assert good and "no depth_rel: the dataset's depth is an estimate" in said
    assert read_added(end.folder).left_out == {
        "depth_rel": "the dataset's depth is an estimate",
        "ms_ssim": "the method has no lens to refocus with",
    }


def test_code_that_renders_otherwise_scores_no_depth(call, tmp_path: Path) -> None:
    """As another process would find it, which has not loaded the method yet."""
    end = call()

    def scored_anew() -> str:
        for name in [name for name in sys.modules if name.startswith("dofbench.methods.fake")]:
            del sys.modules[name]
        return scored(end.folder, "depth_rel")[1]

    data = json.loads((end.folder / "result.json").read_text())
    for column in DEPTH_COLUMNS:
        del data["scores"][column]
    write_again(end.folder / "result.json", data)
    code = tmp_path / "methods" / "fake" / "trainer.py"
    original = code.read_text()
    code.write_text(original.replace("return Rendering(image.", "return Rendering(0.9 * image."))
    assert "renders the kept model otherwise" in scored_anew()
    code.write_text(original.replace("return Rendering(image.", "raise ImportError('gone')\n        return Rendering("))
    assert "can't render the kept model: ImportError: gone" in scored_anew()
    code.write_text(original)
    (end.folder / "model" / "model.json").write_text("[1, {}]")
    assert "model/model.json isn't the file that the run kept" in scored_anew()
    shutil.rmtree(end.folder / "model")
    assert "the run kept no model" in scored_anew()


def test_a_score_that_does_not_come_out_again_is_named(call) -> None:
    end = call()
    data = json.loads((end.folder / "result.json").read_text())
    data["scores"]["ssim"] -= 0.01
    write_again(end.folder / "result.json", data)
    good, said = scored(end.folder, "psnr,ssim")
    assert not good and "ssim is 0." in said and "computed again 0." in said and "the same again: psnr" in said


def test_another_picture_is_not_scored(call) -> None:
    end = call()
    picture = end.folder / "predictions" / "refocus" / "v0.png"
    write_png(picture, read_image(picture) * 0.5)
    good, said = scored(end.folder, "psnr")
    assert not good and "another picture" in said
    assert read_added(end.folder) is None


def test_the_dataset_must_be_the_same(call, tmp_path: Path) -> None:
    end = call()
    shutil.move(tmp_path / "data", tmp_path / "moved")
    good, said = scored(end.folder, "psnr")
    assert not good and "no dataset there or near the result" in said
    assert scored(end.folder, "psnr", data=tmp_path / "moved")[0]
    other = write_dataset(tmp_path / "other", seed=5)
    good, said = scored(end.folder, "psnr", data=other)
    assert not good and "that it was run on" in said


def test_failed_runs_and_runs_at_work_stop_nothing(call, tmp_path: Path) -> None:
    end = call()
    call(set=("trouble=lost",))
    good, said = scored(tmp_path / "results", "aif_gmsd")
    assert good and "skipped, because its run ended diverged" in said and "added aif_gmsd" in said
    with run_lock(end.folder, read_result(end.folder).spec, "waves", "now"):
        good, said = scored(tmp_path / "results", "aif_gmsd")
    assert not good and "another process at work" in said


def test_non_finite_values_stay(call, worst, monkeypatch: pytest.MonkeyPatch) -> None:
    end = call()
    values = iter([math.inf, math.nan, -math.inf, math.inf])
    monkeypatch.setitem(
        METRICS,
        "worst",
        Metric("worst", "worst", "", False, 0.0, 1.0, "images", lambda prediction, truth: next(values), ""),
    )
    assert scored(end.folder, "worst,aif_worst")[0]
    views = read_added(end.folder).scores["worst"].views
    assert math.isinf(views["v0"]) and math.isnan(views["v1"])
    assert math.isnan(read_added(end.folder).scores["worst"].value)


def test_training_again_takes_the_added_scores_away(call) -> None:
    end = call()
    scored(end.folder, "aif_gmsd")
    call(rerun=True)
    assert read_added(end.folder) is None and not (end.folder / "added.json").exists()


def test_added_scores_of_another_result_are_refused(call) -> None:
    end = call()
    scored(end.folder, "aif_gmsd")
    data = json.loads((end.folder / "result.json").read_text())
    write_again(end.folder / "result.json", data | {"ended": "later"})
    with pytest.raises(InputError, match="another result.json"):
        read_added(end.folder)
    assert scored(end.folder, "aif_gmsd")[0]
    assert read_added(end.folder).result_sha256 == sha256_file(end.folder / "result.json")


def test_the_report_shows_what_was_added(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_files, "write_curves", lambda *_: {})
    monkeypatch.setattr(report_files, "write_strip", lambda *_: "this test wants none")
    end = call()
    call(seed=1, method="pinhole")
    scored(end.folder, "aif_gmsd")
    settings = Report(tmp_path / "results", tmp_path / "board")
    assert write_report(settings, Console(quiet=True))
    table = list(csv.DictReader(io.StringIO((tmp_path / "board" / "leaderboard.csv").read_text())))
    value = read_added(end.folder).scores["aif_gmsd"].value
    assert [float(row["aif_gmsd"]) if row["aif_gmsd"] else None for row in table] == [pytest.approx(value), None]
    page = (tmp_path / "board" / "leaderboard.md").read_text().replace("\\", "")  # without Markdown's escapes
    assert "all-in-focus GMSD ↓" in page and "not computed: `dofbench score` adds it" in page
    assert f"- aif_gmsd: by code {read_added(end.folder).scores['aif_gmsd'].code}." in page
    (end.folder / "added.json").write_text("{")
    assert not write_report(settings, Console(quiet=True))  # named, and the rest is there
    assert "added.json" in (tmp_path / "board" / "leaderboard.md").read_text()


# ---- LPIPS, by a user's weights ----


def written_report(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[list[dict[str, str]], str]:
    """The rows of the table and the page of a report on `folder`/results, without curves and pictures."""
    monkeypatch.setattr(report_files, "write_curves", lambda *_: {})
    monkeypatch.setattr(report_files, "write_strip", lambda *_: "this test wants none")
    assert write_report(Report(folder / "results", folder / "board"), Console(quiet=True))
    table = csv.DictReader(io.StringIO((folder / "board" / "leaderboard.csv").read_text()))
    return list(table), (folder / "board" / "leaderboard.md").read_text().replace("\\", "")


@pytest.mark.slow
def test_lpips_is_added_where_weights_are_given(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    end, blind = call(), call(method="pinhole")
    assert (
        "LPIPS" not in written_report(tmp_path, monkeypatch)[1]
        and "lpips_alex" not in (end.folder / "result.json").read_text()
    )
    lpips = load_lpips(weights := write_weights(tmp_path))
    assert app.main(["score", str(tmp_path / "results"), "--lpips", *map(str, weights)]) == 0
    added, data = read_added(end.folder), load_run(end.folder).dataset
    assert {column for column, one in added.scores.items() if one.weights} == {"lpips_alex", "aif_lpips_alex"}
    assert added.scores["lpips_alex"].weights == added.scores["aif_lpips_alex"].weights == lpips.sha256
    for kind, column, read in (
        ("refocus", "lpips_alex", data.image),
        ("all_in_focus", "aif_lpips_alex", data.all_in_focus),
    ):
        assert added.scores[column].views == {
            view.name: lpips(read_image(end.folder / "predictions" / kind / f"{view.name}.png"), read(view))
            for view in data.test_views()
        }
    assert read_added(blind.folder).left_out["lpips_alex"] == "the method has no lens to refocus with"
    assert all(check_result(one.folder).problems == [] for one in (end, blind))
    table, page = written_report(tmp_path, monkeypatch)
    assert float(table[0]["lpips_alex"]) == pytest.approx(added.scores["lpips_alex"].value)
    assert table[1]["lpips_alex"] == "" and float(table[1]["aif_lpips_alex"]) > 0
    assert "LPIPS (AlexNet) ↓" in page and f"weights of sha256 {lpips.sha256}" in page
    assert not any("vgg" in column for column in table[0]) and "VGG16) ↓" not in page


@pytest.mark.slow
def test_lpips_by_other_weights_is_not_compared(call, tmp_path: Path) -> None:
    """A column holds scores by the weights that most runs have."""
    ends = [call(seed=seed) for seed in range(3)]
    first, second = write_weights(tmp_path), write_weights(tmp_path, seed=1)
    for end, weights in zip(ends, (first, second, first), strict=True):
        assert scored(end.folder, "aif_lpips_alex", lpips=weights)[0]
    entries = collect(tmp_path / "results").entries
    assert ["aif_lpips_alex" in entry.scores for entry in entries] == [True, False, True]
    assert f"by weights of sha256 {load_lpips(second).sha256[:8]}" in entries[1].left_out["aif_lpips_alex"]
    assert scored(ends[1].folder, "aif_lpips_alex", lpips=first)[0]
    assert all("aif_lpips_alex" in entry.scores for entry in collect(tmp_path / "results").entries)


def test_scores_without_weights_keep_those_with(call, tmp_path: Path) -> None:
    end = call()
    scored(end.folder, "lpips_alex", lpips=write_weights(tmp_path))
    before = read_added(end.folder).scores["lpips_alex"]
    assert scored(end.folder, "aif_gmsd")[0] and read_added(end.folder).scores["lpips_alex"] == before
    # A version without LPIPS can read what has none.
    assert "weights" not in json.loads((end.folder / "added.json").read_text())["scores"]["aif_gmsd"]


def test_small_images_have_no_lpips(call, tmp_path: Path) -> None:
    end = call()
    lpips = load_lpips(write_weights(tmp_path))
    lpips.smallest = 49  # the images have 48 px
    good = score_result(load_run(end.folder), ("psnr", "lpips_alex"), lpips)
    assert good.again == ["psnr"] and "images of 48 px" in good.left_out["lpips_alex"]


@pytest.mark.parametrize(
    ("metrics", "weights", "match"),
    [
        ("lpips_alex", None, "weights of LPIPS .AlexNet. in --lpips"),
        ("aif_lpips_vgg", "alex", "weights of LPIPS .VGG16. in --lpips"),
        ("lpips", None, "did you mean lpips_"),
    ],
)
def test_columns_of_lpips_need_its_weights(call, tmp_path: Path, metrics: str, weights: str | None, match: str) -> None:
    call()
    with pytest.raises(InputError, match=match):
        score([tmp_path / "results"], metrics, lpips=write_weights(tmp_path, weights) if weights else None)


def test_wrong_weights_are_a_wrong_call(call, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    end = call()
    (tmp_path / "text.pth").write_text("no weights")
    backbone, _ = write_weights(tmp_path)
    for words in ([], ["text.pth"], [backbone.name], ["results"], ["none.pth"]):
        assert app.main(["score", str(end.folder), "--lpips", *(str(tmp_path / word) for word in words)]) == 2
        printed = capsys.readouterr()
        assert re.fullmatch(r"dofbench: .+: found .+, expected .+\n", printed.err) and not printed.out
    assert read_added(end.folder) is None


@pytest.mark.parametrize(
    ("path", "metrics", "match"),
    [
        ("nowhere", None, "no such file"),
        ("methods", None, "no result.json"),
        ("results", "lpips", "--metrics"),
        ("results", "delta_a", "--metrics"),
        ("results", "", "--metrics"),
    ],
)
def test_wrong_calls(call, tmp_path: Path, path: str, metrics: str | None, match: str) -> None:
    call()
    with pytest.raises(InputError, match=match):
        score([tmp_path / path], metrics)
