"""Runs on photographs of unknown lens: only scores with ground truth are computed, and reports have no empty column."""

from __future__ import annotations

import html
import io
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lpips_weights import write_weights
from relisted import write_again
from rich.console import Console
from small_dataset import write_dataset

from dofbench.core.errors import Status
from dofbench.core.images import read_image
from dofbench.core.jobs import Outcome
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.comparing.means import seed_mean
from dofbench.evaluation.metrics.lpips import load_lpips
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.protocol import BLUR_COLUMNS, PICTURE_BLUR
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.scoring import photograph_scores
from dofbench.evaluation.scoring.photograph_scores import ScoredPixels
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report
from dofbench.running.check_results import check_result
from dofbench.running.load_run import load_run
from dofbench.running.rescore import score, score_result

EVERY, TRAINED = [f"v{index}" for index in range(6)], [f"v{index}" for index in range(2, 6)]


@pytest.fixture
def unknown(call: Callable[..., Outcome], tmp_path: Path) -> Callable[..., Outcome]:
    """A run on a dataset of photographs: `unknown(blurred=…)` as `write_dataset`."""

    def run(**dataset) -> Outcome:
        options = {"unknown": EVERY, "blurred": TRAINED, "flat": EVERY, "exact": False, **dataset}
        return call(data=write_dataset(tmp_path / "photographs", name="seal", **options))

    return run


def test_what_has_its_truth_is_scored(unknown: Callable[..., Outcome]) -> None:
    result = read_result(unknown().folder)
    assert result.status is Status.OK and check_result(unknown().folder).problems == []
    assert {"aif_psnr", "aif_ssim", "aif_flip", "train_s", "render_fps"} <= result.scores.keys()
    assert not {"psnr", "delta_a", "disparity_error"} & result.scores.keys()
    assert result.left_out["psnr"] == "no test lens" and result.left_out["delta_a"] == "no true lens"
    assert result.do_nothing == {} and result.lens == []
    assert all(
        set(view.scores) == {"aif_psnr", "aif_ssim", "aif_ssim_uniform7", "aif_flip", "resolved"}
        for view in result.views
    )
    assert all(set(point.scores) == {"aif_psnr", "aif_ssim"} for point in result.curve)
    assert not any(name.startswith("predictions/refocus") for name in result.predictions)


def test_a_run_that_nothing_can_be_scored_of_still_ends_well(call: Callable[..., Outcome], tmp_path: Path) -> None:
    folder = call(
        data=write_dataset(
            tmp_path / "photographs", name="seal", unknown=TRAINED, blurred=EVERY, flat=EVERY, test=0, train=6
        )
    ).folder
    result = read_result(folder)
    assert result.status is Status.OK and check_result(folder).problems == [] and result.scores["steps"] == 8
    assert result.left_out["aif_psnr"] == "the dataset has no test views" and result.predictions == {}
    stream = io.StringIO()
    write_report(Report(results=tmp_path / "results", out=tmp_path / "report"), Console(file=stream, width=300))
    assert "no run has predictions" in stream.getvalue()


def test_some_lenses_unknown(call: Callable[..., Outcome], tmp_path: Path) -> None:
    result = read_result(call(data=write_dataset(tmp_path / "mixed", unknown=["v0"])).folder)
    assert result.left_out["psnr"] == "no test lens of 1 of 2 test views: v0"
    assert {"aif_psnr", "delta_a", "delta_r", "depth_rel"} <= result.scores.keys()
    assert result.do_nothing.keys() == {"delta_a", "delta_f", "delta_r"}


def test_the_report_shows_no_column_without_a_value(
    unknown: Callable[..., Outcome], call: Callable[..., Outcome], tmp_path: Path
) -> None:
    unknown()
    call(method="pinhole", data=tmp_path / "photographs")
    write_report(Report(results=tmp_path / "results", out=tmp_path / "report"), Console(quiet=True))
    page = (tmp_path / "report" / "leaderboard.md").read_text()
    board = page[page.index("## seal") : page.index("## Scores")]
    heading = next(line for line in board.splitlines() if line.startswith("| method"))
    assert "all-in-focus PSNR" in heading
    assert not any(word in heading for word in ("| PSNR", "δ", "disparity error", "AbsRel"))
    assert "trained on unknown lenses; no test lens" in board
    assert "do nothing" not in board and "no test lens" in board[board.index("Not shown") :]
    assert (tmp_path / "report" / "comparison" / "seal-refocus-v3.png").is_file()


@pytest.mark.slow
def test_photographs_are_scored_by_what_half_of_each_tells(call: Callable[..., Outcome], tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    end = call(data=data)
    result = read_result(end.folder)
    assert result.spec.protocol == "photographs-v2" and check_result(end.folder).problems == []
    assert {"photo_psnr", "photo_ssim", "photo_sharp_psnr", "photo_no_lens", "photo_at_bound"} <= result.scores.keys()
    assert {"photo_blur", "photo_blur_bias", "photo_sharp_blur"} <= result.scores.keys()
    assert not {"psnr", "aif_psnr", "delta_a"} & result.scores.keys()
    assert [fit.name for fit in result.fits] == ["v0", "v1"] and all(len(fit.halves) == 1 for fit in result.fits)
    assert all(half.fitted_on == 0 and half.renders > 10 for fit in result.fits for half in fit.halves)
    assert set(result.predictions) >= {"predictions/photograph/v0.png", "predictions/photograph_error/v1.png"}
    assert all({"photo_psnr", "photo_ssim"} == point.scores.keys() for point in result.curve)

    blind = read_result(call(method="pinhole", data=data).folder)
    assert "the method has no lens" in blind.left_out["photo_no_lens"] and blind.scores["photo_psnr"] > 0
    assert all(half.aperture is None and not half.at_bound for fit in blind.fits for half in fit.halves)
    assert blind.scores["photo_psnr"] == blind.scores["photo_sharp_psnr"]
    assert blind.scores["photo_blur"] == blind.scores["photo_sharp_blur"] > 0
    off = read_result(call(data=data, set=("lens=false",)).folder)
    assert "no lens here" in off.left_out["photo_no_lens"] and check_result(end.folder).problems == []

    # By a user's weights, the prediction of a photograph against it.
    lpips = load_lpips(write_weights(tmp_path))
    found = score_result(load_run(end.folder), None, lpips)
    dataset = Dataset.load(data)
    truth, mask = dataset.image(dataset.test_views()[0]), ScoredPixels(dataset).of(dataset.test_views()[0])[0]
    views = found.added["photo_lpips_alex"].views
    assert views["v0"] == lpips(read_image(end.folder / "predictions" / "photograph" / "v0.png"), truth, mask)
    assert not any("lpips" in column for column in found.left_out)
    assert score([end.folder], "photo_lpips_alex", lpips=write_weights(tmp_path), console=Console(quiet=True))

    write_report(Report(results=tmp_path / "results", out=tmp_path / "report"), Console(quiet=True))
    page = (tmp_path / "report" / "leaderboard.md").read_text()
    board = page[page.index("## seal") : page.index("## Scores")]
    heading = next(line for line in board.splitlines() if line.startswith("| method"))
    assert "photograph PSNR [dB]" in heading and "| PSNR" not in heading and "| all-in-focus" not in heading
    assert "photograph LPIPS (AlexNet) ↓" in heading.replace("\\", "")
    assert (tmp_path / "report" / "curves" / "seal-photographs-v2-photo_psnr.svg").is_file()
    assert "Photographs of unknown lens" in (tmp_path / "report" / "report.html").read_text()
    assert (tmp_path / "report" / "comparison" / "seal-photographs-v2.png").is_file()


def test_a_picture_that_isnt_what_was_scored_is_noticed(call: Callable[..., Outcome], tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    folder = call(data=data).folder
    file = folder / "result.json"
    stored = json.loads(file.read_text())
    for view in stored["views"]:
        view["scores"]["photo_psnr"] += 0.5
    stored["scores"]["photo_psnr"] += 0.5
    write_again(file, stored)
    assert any("photo_psnr is" in line and "computed again" in line for line in check_result(folder).problems)


def test_a_result_scored_before_there_was_blur_is_read_and_can_be_given_it(
    call: Callable[..., Outcome], tmp_path: Path
) -> None:
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    folder = call(data=data).folder
    measured = read_result(folder).scores
    file = folder / "result.json"
    stored = json.loads(file.read_text())
    for scores in (stored["scores"], *(view["scores"] for view in stored["views"])):
        for column in BLUR_COLUMNS:
            del scores[column]
    for columns in (stored["plan"]["columns"], stored["protocol"]["photograph"]):
        columns[:] = [column for column in columns if column not in BLUR_COLUMNS]
    write_again(file, stored)
    assert check_result(folder).problems == []
    (entry,) = collect(folder).entries
    assert "scored before" in seed_mean([entry], "photo_blur").reason
    assert score([folder], console=Console(quiet=True))
    (entry,) = collect(folder).entries
    assert [seed_mean([entry], column).value for column in PICTURE_BLUR] == [measured[one] for one in PICTURE_BLUR]
    assert "scored before" in seed_mean([entry], "photo_sharp_blur").reason
    assert check_result(folder).problems == []
    stored["protocol"]["photograph"][0] = "photo_ssim"
    write_again(file, stored)
    assert any("its photograph is not" in line for line in check_result(folder).problems)


def test_bounds_stand_beside_the_score_and_the_page_says_what_cannot_rank(
    call: Callable[..., Outcome], tmp_path: Path
) -> None:
    """The fake method learns one lens; its photographs are a scene unit apart, so no three rays are close."""
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    result = read_result(call(data=data).folder)
    assert result.scores["lens_energy"] > 0 and result.scores["lens_seen"] == 0
    assert "0.0 % of the pixels (10 % are needed)" in result.no_ranking
    assert math.isfinite(result.scores["photo_fit_psnr"])
    blind = read_result(call(method="pinhole", data=data).folder)
    assert blind.no_ranking == "" and "no learned lens" in blind.left_out["lens_energy"]
    assert "photo_fit_psnr" in blind.scores and "lens_seen" not in blind.scores
    assert check_result(call(data=data).folder).problems == []
    write_report(Report(results=tmp_path / "results", out=tmp_path / "report", pictures=False), Console(quiet=True))
    for page in ("leaderboard.md", "report.html", "scores.html"):
        text = html.unescape((tmp_path / "report" / page).read_text())
        assert text.count("This dataset can't rank lenses: blur explains") == 1, page
    assert "fit ceiling, PSNR" in (tmp_path / "report" / "report.html").read_text()
    file = call(data=data).folder / "result.json"
    write_again(file, {**json.loads(file.read_text()), "no_ranking": ""})
    assert any("no_ranking: no reason, though" in line for line in check_result(file.parent).problems)


def test_pictures_of_test_views_alone_are_scored(call: Callable[..., Outcome], tmp_path: Path) -> None:
    """A method whose pictures others made has none of training views, and isn't asked for them."""
    card, code = ((tmp_path / "methods" / "pinhole" / name) for name in ("method.toml", "trainer.py"))
    card.write_text(card.read_text().replace("[capabilities]", "[capabilities]\ndepth = false\ntrains = false"))
    asked = tmp_path / "asked"
    told = f"    def render(self, camera, lens):\n        open({str(asked)!r}, 'a').write(f'{{camera.centre}}\\n')"
    code.write_text(code.read_text().replace("    def render(self, camera, lens):", told))
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    result = read_result(call(method="pinhole", data=data).folder)
    assert result.status is Status.OK and "photo_psnr" in result.scores and "photo_fit_psnr" not in result.scores
    assert "no pictures of training views" in result.left_out["photo_fit_psnr"]
    assert not {"train_s", "train_cpu_s", "cold_start_s", "peak_mb"} & result.scores.keys() and result.curve == []
    assert (
        "made elsewhere" in result.left_out["train_s"]
        and check_result(call(method="pinhole", data=data).folder).problems == []
    )
    dataset = Dataset.load(data)
    assert set(asked.read_text().splitlines()) == {str(view.camera.centre) for view in dataset.test_views()}


def test_a_prediction_that_isnt_finite_is_a_failure(call: Callable[..., Outcome], tmp_path: Path) -> None:
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    result = read_result(call(data=data, set=("trouble=hole",)).folder)
    assert result.status is Status.DIVERGED and result.nonfinite[0].stage == "render photograph"


def test_a_view_of_which_coverage_is_unknown_ends_no_training(
    call: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Test views may lack different columns: one has too few sparse points, the other has not."""
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=EVERY, blurred=EVERY, flat=EVERY, exact=False)
    second = Dataset.load(data).test_views()[1].camera.world_to_camera

    def known_of_the_first(points, camera, training):
        return None if np.array_equal(camera.world_to_camera, second) else np.ones((camera.height, camera.width), bool)

    monkeypatch.setattr(photograph_scores, "covered", known_of_the_first)
    result = read_result(call(data=data).folder)
    assert result.status is Status.OK and "photo_psnr" in result.curve[-1].scores
    assert "photo_covered" not in result.scores and "sparse points" in result.left_out["photo_covered"]
