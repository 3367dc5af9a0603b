"""Runs from beginning to end, what they measure and what they say."""

from __future__ import annotations

import io
import math
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness_fakes import text_console
from rich.console import Console
from small_dataset import write_dataset
from tolerances import PSNR_OF_FLOAT32

from dofbench.core.clock import Stopwatch, loading
from dofbench.core.errors import InputError, Status
from dofbench.core.files import sha256_file
from dofbench.core.images import read_image
from dofbench.evaluation.results.protocol import DEPTH_COLUMNS, LENS_COLUMNS, PROTOCOLS
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.scoring.evaluate import Evaluator
from dofbench.running import execution, plan
from dofbench.running.check_results import check_result
from dofbench.running.load_run import load_run
from dofbench.runtime import kernel_cache

OPEN = PROTOCOLS["refocus-v3"]


def test_a_run_keeps_the_memory_that_it_frees(call, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that only says what it would do leaves the process as it is."""
    asked: list[bool] = []
    monkeypatch.setattr(execution, "keep_freed_memory", lambda: asked.append(True))
    call(dry_run=True)
    assert not asked
    call()
    assert asked


def test_a_good_run(call, tmp_path: Path) -> None:
    end = call()
    assert end and end.status is Status.OK and not end.reused
    assert end.folder.parent == tmp_path / "results" / "waves"
    result = read_result(end.folder)
    assert end.folder.name == f"fake-quick-seed0-{result.key[:8]}"
    assert set(result.scores) == {
        *OPEN.refocus_columns,
        *OPEN.all_in_focus_columns,
        *LENS_COLUMNS,
        *DEPTH_COLUMNS,
        "train_s",
        "train_cpu_s",
        "cold_start_s",
        "steps",
        "render_fps",
        "peak_mb",
        "gaussians",
        "resolved",
    }
    assert result.scores["steps"] == 8 and result.scores["gaussians"] == 80
    assert result.scores["psnr"] > 30 and result.scores["peak_mb"] > 10
    assert [point.steps for point in result.curve][:: len(result.curve) - 1] == [1, 8]
    assert result.curve[-1].scores["psnr"] > result.curve[0].scores["psnr"] + 10
    assert {"psnr", "ssim", "aif_psnr", "aif_ssim", *LENS_COLUMNS} == set(result.curve[0].scores)
    assert result.left_out_stages == {"normals": "a fake has none"} and result.method_stages == {"guess": 0.01}
    assert {"train", "score", "evaluate during training"} <= set(result.stages)
    assert result.model == {"model/model.json": sha256_file(end.folder / "model" / "model.json")}
    assert result.machine["threads"] >= 1
    assert sorted(path.name for path in end.folder.iterdir()) == ["model", "predictions", "result.json"]


def test_only_kernels_compiled_by_the_run_itself_count(call, monkeypatch: pytest.MonkeyPatch) -> None:
    call()  # whatever the scores need lies on disk now
    monkeypatch.setattr(kernel_cache, "_compiled", 29)  # by earlier work in this process
    assert read_result(call(seed=1).folder).kernels_compiled == 0
    assert read_result(call(set=("trouble=compile",)).folder).kernels_compiled == 2


def test_scores_are_of_what_was_saved(call, tmp_path: Path) -> None:
    end = call()
    run = load_run(end.folder)
    result, data = run.result, run.dataset
    for view in data.test_views():
        scored = next(found for found in result.views if found.name == view.name)
        saved = read_image(end.folder / "predictions" / "refocus" / f"{view.name}.png")
        error = np.mean((saved.astype(np.float64) - data.image(view)) ** 2)
        assert scored.scores["psnr"] == pytest.approx(-10 * math.log10(error), abs=PSNR_OF_FLOAT32)
    mean = np.mean([view.scores["psnr"] for view in result.views])
    assert result.scores["psnr"] == pytest.approx(mean)


def test_the_rendered_depth_is_compared_with_the_exact_one(call, tmp_path: Path) -> None:
    run = load_run(call().folder)
    result, data = run.result, run.dataset
    disparity, relative = [], []
    for view in data.test_views():  # the fake renders z = 1 everywhere
        truth = data.depth(view).astype(np.float64)
        disparity.append(np.abs(1 - 1 / truth).mean() / 0.5)
        relative.append(((truth - 1) / truth).mean())
    assert [view.scores["depth_rel"] for view in result.views] == pytest.approx(relative)
    assert result.scores["disparity_error"] == pytest.approx(np.mean(disparity))
    assert result.scores["depth_rel"] == pytest.approx(np.mean(relative))


def test_an_estimated_depth_is_compared_with_nothing(call, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", exact=False)
    result = read_result(call().folder)
    assert not set(DEPTH_COLUMNS) & set(result.scores)
    assert "is an estimate" in result.left_out["disparity_error"]


def test_depth_that_is_no_number_is_seen(call, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "fake" / "trainer.py"
    code.write_text(code.read_text().replace("np.ones(image.shape[:2]", "np.full(image.shape[:2], np.nan"))
    end = call()
    assert end.status is Status.DIVERGED
    result = read_result(end.folder)
    assert "values of the depth of view v0" in result.message and math.isnan(result.scores["disparity_error"])
    assert result.nonfinite[0].stage == "render depth"


def test_lens_errors_of_every_training_view(call) -> None:
    result = read_result(call().folder)
    assert [lens.name for lens in result.lens] == ["v2", "v3", "v4", "v5"]
    for lens in result.lens:
        assert lens.delta_a == pytest.approx(abs(lens.aperture - lens.aperture_estimated))
        assert lens.delta_f == pytest.approx(abs(lens.focus - lens.focus_estimated))
    for column in ("delta_a", "delta_f", "delta_r"):
        assert result.curve[-1].scores[column] == pytest.approx(result.scores[column])
    true = [(0.5, 0.8), (1.0, 0.2), (0.5, 0.5), (1.0, 0.8)]
    assert result.do_nothing["delta_a"] == pytest.approx(np.mean([abs(a - 0.5) for a, _ in true]))
    assert result.do_nothing["delta_f"] == pytest.approx(np.mean([abs(f - 0.5) for _, f in true]))


def test_same_seed_same_scores(call) -> None:
    one = read_result(call().folder)
    two = read_result(call(rerun=True).folder)
    timed = {"train_s", "train_cpu_s", "cold_start_s", "render_fps", "peak_mb"}
    assert {k: v for k, v in one.scores.items() if k not in timed} == {
        k: v for k, v in two.scores.items() if k not in timed
    }
    assert one.predictions == two.predictions


def test_a_budget_of_seconds(call) -> None:
    result = read_result(call(budget="0.3s", set=("pause=0.02",)).folder)
    assert 0.3 <= result.scores["train_s"] < 1.0
    assert 5 <= result.scores["steps"] <= 16


def test_compilation_is_not_training_time(call, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "fake" / "behaviour.py"
    compiling = (
        "compiled = []\n\n\ndef misbehave(options, step, loss):\n"
        "    if not compiled:\n        compiled.append(time.sleep(0.5))\n"
    )
    code.write_text(code.read_text().replace("def misbehave(options, step, loss):\n", compiling))
    result = read_result(call(budget="0.3s", set=("pause=0.02",)).folder)
    assert result.status is Status.OK and result.scores["steps"] >= 5
    assert result.stages["warm up"].wall >= 0.5
    assert result.scores["cold_start_s"] == pytest.approx(result.stages["import"].wall + result.stages["warm up"].wall)
    assert result.scores["train_s"] == result.stages["train"].wall


def test_processor_time_is_told_from_wall_time(call, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "fake" / "behaviour.py"
    code.write_text(code.read_text().replace('    time.sleep(options["pause"])\n', "    time.sleep(0.02)\n"))
    result = read_result(call().folder)
    assert result.scores["train_cpu_s"] == result.stages["train"].cpu
    assert result.scores["train_cpu_s"] < 0.7 * result.scores["train_s"]  # it sleeps
    cpu = [point.train_cpu_s for point in result.curve]
    assert cpu == sorted(cpu) and 0 <= cpu[0] <= cpu[-1] <= result.scores["train_cpu_s"]


def test_the_processor_time_of_other_processes_counts_when_they_end() -> None:
    watch = Stopwatch()
    with watch.running():
        subprocess.run([sys.executable, "-c", "sum(range(10**7))"], check=True)
    assert watch.cpu > 0.05
    other = Stopwatch()
    other.move(watch)
    assert other.cpu > 0.05 and watch.cpu == watch.wall == 0.0


def test_imports_are_counted_once(call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loading, "_wall", 10_000.0)  # seconds, as if importing had taken so long
    assert read_result(call().folder).scores["cold_start_s"] > 10_000
    assert read_result(call(seed=1).folder).scores["cold_start_s"] < 10_000


def test_planning_is_no_cold_start(call, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, ahead, look = time.perf_counter, [0.0], plan._facts

    def slow(*arguments: Any) -> Any:
        ahead[0] += 10_000.0  # seconds
        return look(*arguments)

    monkeypatch.setattr(time, "perf_counter", lambda: clock() + ahead[0])
    monkeypatch.setattr(plan, "_facts", slow)
    result = read_result(call().folder)
    assert result.scores["cold_start_s"] < 10_000 < result.stages["plan"].wall


def test_the_preset_says_steps_where_it_has_no_budget(call) -> None:
    assert read_result(call(preset="slow").folder).spec.budget == "12it"
    with pytest.raises(InputError, match="budget"):
        call(preset="slow", set=("steps=many",))


@pytest.mark.parametrize("interrupted", [False, True])
def test_what_training_decided_stands_in_the_result_with_its_reason(call, monkeypatch, interrupted: bool) -> None:
    def stop(self, folder, progress):
        raise KeyboardInterrupt

    if interrupted:  # then what was decided comes from the file of the finished training
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(Evaluator, "final", stop)
            call(set=("trouble='no lens'",))
    end = call(set=("trouble='no lens'",))
    result = read_result(end.folder)
    assert result.status is Status.OK and check_result(end.folder).problems == []
    stages = {stage["name"]: stage for stage in result.plan["stages"]}
    assert not stages["lens"]["runs"] and stages["lens"]["reason"] == "held-out PSNR +0.00 dB with the lens"
    assert result.left_out_stages["lens"] == "held-out PSNR +0.00 dB with the lens"
    for column in ("psnr", "delta_a"):
        assert column not in result.scores and "+0.00 dB" in result.left_out[column]
    assert "aif_psnr" in result.scores


def test_a_method_that_refuses_to_refocus_leaves_it_out(call) -> None:
    result = read_result(call(set=("lens=false",)).folder)
    assert result.status is Status.OK
    assert "no lens here" in result.left_out["psnr"] and "psnr" not in result.scores
    assert result.left_out["delta_a"] == "the method gave no lens estimates"
    assert result.scores["aif_psnr"] > 30


def test_leaving_out_a_needless_lens_changes_no_other_score(call, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", in_focus=True)
    left_out, forced = (read_result(call(force_all=force).folder) for force in (False, True))
    assert left_out.left_out_stages["lens"].startswith("estimated CoC radius up to 0.17 px")
    assert left_out.scores["aif_psnr"] == forced.scores["aif_psnr"]
    assert "delta_a" in forced.scores and "delta_a" not in left_out.scores


def test_without_test_views_there_are_only_lens_errors(call, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", test=0)
    result = read_result(call().folder)
    assert result.status is Status.OK and result.views == []
    assert "psnr" not in result.scores and result.left_out["render_fps"] == "the dataset has no test views"


def test_a_dry_run_writes_nothing(call, tmp_path: Path) -> None:
    console, stream = text_console()
    assert call(console, dry_run=True).status is None
    assert "budget 8it" in stream.getvalue()
    assert not (tmp_path / "results").exists()
    with pytest.raises(InputError, match="nose"):
        call(dry_run=True, set=("nose=1",))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"device": "tpu"}, "--device"),
        ({"device": "cuda"}, "--device"),
        ({"inputs": "blurry"}, "inputs"),
        ({"data": Path("nowhere")}, "nowhere"),
        ({"data": None}, "data: found none"),
    ],
)
def test_wrong_calls(call, change: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        call(**change)


def test_a_terminal_gets_a_bar_and_the_files_place(call) -> None:
    stream = io.StringIO()
    end = call(Console(file=stream, width=300, force_terminal=True, color_system=None))
    shown = stream.getvalue()
    assert "training" in shown and "8 of 8" in shown
    assert f"result {end.folder / 'result.json'}" in shown


def test_a_log_gets_plain_lines(call) -> None:
    console, stream = text_console()
    call(console)
    assert "8 of 8, loss 0.1250" in stream.getvalue() and "\x1b" not in stream.getvalue()


def test_a_dataset_whose_files_changed_isnt_run_on(call, tmp_path):
    folder = call().folder
    image = next((tmp_path / "data" / "images").iterdir())
    content = bytearray(image.read_bytes())
    content[-20] ^= 1
    image.write_bytes(content)
    before = (folder / "result.json").read_bytes()
    for rerun in (False, True):
        with pytest.raises(InputError, match=f"{image.name}: found a changed file"):
            call(rerun=rerun)
    assert (folder / "result.json").read_bytes() == before


def test_a_link_out_of_the_results_folder_is_not_written_through(call, tmp_path):
    folder = call().folder
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "v0.png").write_text("precious")
    shutil.rmtree(folder / "predictions" / "refocus")
    (folder / "predictions" / "refocus").symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match="a link to"):
        call(rerun=True)
    assert (tmp_path / "outside" / "v0.png").read_text() == "precious"
