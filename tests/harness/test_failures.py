"""Runs that fail, are interrupted or killed, or meet another one at the same result."""

from __future__ import annotations

import json
import math
import signal
import sys
import time
from pathlib import Path

import pytest
from called import killed
from harness_fakes import text_console

from dofbench.core.errors import InputError, Status
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_lock import at_work, read_lock, run_lock
from dofbench.evaluation.scoring.evaluate import Evaluator


@pytest.mark.parametrize(
    ("trouble", "status", "message"),
    [
        ("lost", Status.DIVERGED, "loss is nan at step 3"),
        ("crash", Status.CRASHED, "RuntimeError: something broke"),
        ("memory", Status.OUT_OF_MEMORY, "MemoryError: no more"),
        ("overflow", Status.DIVERGED, "FloatingPointError: overflow in exp"),
        ("deaf", Status.CRASHED, "told to stop"),
    ],
)
def test_a_failing_run_leaves_a_typed_result(call, trouble: str, status: Status, message: str) -> None:
    console, stream = text_console()
    end = call(console, set=(f"trouble={trouble}",))
    assert not end and end.status is status
    result = read_result(end.folder)
    assert result.status is status and message in result.message
    assert message in stream.getvalue()
    assert "psnr" not in result.scores and result.scores["steps"] >= 2 and result.curve
    raised = trouble != "lost"
    assert ("Traceback" in result.traceback) == raised
    assert bool(result.nonfinite) == (trouble == "lost")


def test_out_of_time(call) -> None:
    end = call(budget="0.01s", set=("pause=0.05",))
    assert end.status is Status.OUT_OF_TIME


def test_a_non_finite_prediction_is_a_divergence_and_its_nan_is_kept(call) -> None:
    end = call(set=("trouble=hole",))
    result = read_result(end.folder)
    assert result.status is Status.DIVERGED and "1 of" in result.message
    assert math.isnan(result.scores["psnr"]) and math.isnan(result.curve[0].scores["psnr"])
    assert result.nonfinite[0].stage == "render refocus"


def test_a_wrong_input_found_while_training_is_passed_on(call, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="points"):
        call(set=("trouble=input",))
    assert not list((tmp_path / "results").rglob("result.json"))


def test_a_crash_is_tried_again_and_a_divergence_is_not(call) -> None:
    assert not call(set=("trouble=crash",)).reused and not call(set=("trouble=crash",)).reused
    assert not call(set=("trouble=lost",)).reused and call(set=("trouble=lost",)).reused


@pytest.mark.parametrize("place", ["interrupt", "interrupt-in-kernel"])
def test_an_interrupted_run_says_so(call, tmp_path: Path, place: str) -> None:
    with pytest.raises(KeyboardInterrupt):
        call(set=(f"trouble={place}",))
    (file,) = (tmp_path / "results").rglob("result.json")
    result = read_result(file)
    assert result.status is Status.INTERRUPTED and result.message.startswith("after 2 steps")


def test_a_run_interrupted_while_it_scores_goes_on_from_there(call, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = call()
    expected = read_result(reference.folder)

    def interrupted(self, folder, progress):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Evaluator, "final", interrupted)
        call(rerun=True)
    console, stream = text_console()
    end = call(console)
    result = read_result(end.folder)
    assert "using the finished training" in stream.getvalue()
    assert end.status is Status.OK and result.predictions == expected.predictions
    assert result.scores["steps"] == 8 and [p.steps for p in result.curve] == [p.steps for p in expected.curve]
    assert {"train", "load model", "score"} <= set(result.stages)
    assert not (end.folder / "trained.json").exists()


def test_two_processes_never_write_one_result(call) -> None:
    end = call()
    spec = read_result(end.folder).spec
    with run_lock(end.folder, spec, "waves", "now"):
        assert at_work(end.folder)
        with pytest.raises(InputError, match="another process"):
            call()
    assert not at_work(end.folder)
    assert not (end.folder / "running.lock").exists()


def test_a_killed_process_leaves_a_trace(call, tmp_path: Path) -> None:
    spec = read_result(call().folder).spec
    script = (
        "import json, sys, time\nfrom pathlib import Path\n"
        "from dofbench.evaluation.results.run_lock import run_lock\n"
        "from dofbench.evaluation.results.result import Spec\n"
        "with run_lock(Path(sys.argv[1]), Spec(**json.loads(sys.argv[2])), 'waves', 'noon'):\n"
        "    Path(sys.argv[3]).touch()\n    time.sleep(60)\n"
    )
    folder, ready = tmp_path / "killed", tmp_path / "ready"
    command = [sys.executable, "-c", script, str(folder), json.dumps(spec.model_dump()), str(ready)]
    seen = []

    def locked_there() -> bool:
        there = ready.is_file()
        seen.append(there and at_work(folder))
        return there

    assert killed(command, locked_there).returncode == -signal.SIGKILL and seen[-1]
    deadline = time.monotonic() + 5
    while at_work(folder) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not at_work(folder)
    assert read_lock(folder) == (spec, "waves", "noon")


def test_a_prediction_of_a_wrong_size_is_a_crash(call, tmp_path: Path) -> None:
    code = tmp_path / "methods" / "fake" / "trainer.py"
    code.write_text(code.read_text().replace("return Rendering(image.", "return Rendering(image[1:]."))
    result = read_result(call().folder)
    assert result.status is Status.CRASHED
    assert "expected an image of shape (48, 64, 3), found (47, 64, 3)" in result.message


def test_what_a_process_left_that_died_after_its_result_is_cleared_away(call) -> None:
    end = call()
    (end.folder / "trained.json").write_text("{}")
    assert call().reused and not (end.folder / "trained.json").exists()
