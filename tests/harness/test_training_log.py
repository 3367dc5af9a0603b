"""The learning curve as TensorBoard reads it back: the numbers of result.json, and a training that it leaves alone."""

from __future__ import annotations

import importlib.util
import io
import json
import re
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from harness_fakes import text_console
from PIL import Image
from small_dataset import write_dataset
from tensorboard.backend.event_processing.event_accumulator import IMAGES, SCALARS, EventAccumulator

from dofbench.core.errors import InputError
from dofbench.evaluation.results.result import CurvePoint, Result, read_result
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.evaluation.scoring.evaluate import Evaluator
from dofbench.running.plan import make_plan
from dofbench.running.training_log import LOG_FOLDER, TensorBoardLog


def events(folder: Path) -> EventAccumulator:
    return EventAccumulator(str(folder), size_guidance={SCALARS: 0, IMAGES: 0}).Reload()


def scalars(read: EventAccumulator) -> dict[str, list[tuple[int, float]]]:
    """(step, value) of every scalar by tag."""
    return {tag: [(event.step, event.value) for event in read.Scalars(tag)] for tag in read.Tags()["scalars"]}


def scalars_of(curve: list[CurvePoint]) -> dict[str, list[tuple[int, float]]]:
    """The same of a curve, in single precision."""
    values: dict[str, list[tuple[int, float]]] = {}
    for point in curve:
        one = {"loss": point.loss, "time/train_s": point.train_s, "time/train_cpu_s": point.train_cpu_s}
        one |= {f"scores/{column}": score for column, score in point.scores.items()}
        for tag, value in one.items():
            assert value is not None
            values.setdefault(tag, []).append((point.steps, float(np.float32(value))))
    return values


def decisive(result: Result) -> tuple:
    """All that a run's log could have altered, times and sizes of memory apart."""
    scores = {name: value for name, value in result.scores.items() if not name.endswith(("_s", "_mb", "_fps"))}
    curve = [(point.steps, point.loss, point.scores) for point in result.curve]
    return result.key, result.command, result.model, result.predictions, scores, curve


def test_the_log_has_the_numbers_of_the_curve(call) -> None:
    console, said = text_console()
    end = call(console, log="tensorboard")
    assert f"tensorboard --logdir {end.folder / LOG_FOLDER}" in said.getvalue()
    result = read_result(end.folder)
    assert len(result.curve) > 3
    assert scalars(events(end.folder / LOG_FOLDER)) == scalars_of(result.curve)


@pytest.mark.slow
def test_tensorboard_shows_it(call) -> None:
    """Its server of data, which is another program than the reader above, drops what it doesn't expect."""
    end = call(log="tensorboard")
    server = subprocess.Popen(
        [sys.executable, "-m", "tensorboard.main", "--logdir", str(end.folder), "--port", "0"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stderr is not None
        address = next(found[0] for line in server.stderr if (found := re.findall(r"http://localhost:\d+", line)))

        def told(place: str) -> dict:
            with urllib.request.urlopen(f"{address}/data/plugin/{place}/tags") as answer:
                return json.load(answer).get(LOG_FOLDER, {})

        until = time.monotonic() + 60
        while not (scores := told("scalars")) and time.monotonic() < until:
            time.sleep(0.2)
    finally:
        server.terminate()
        server.communicate()
    assert {"loss", "scores/psnr", "scores/aif_ssim", "time/train_s"} <= scores.keys()


def test_the_log_shows_a_test_view_at_every_point(call) -> None:
    end = call(log="tensorboard", set=("noise=0",))
    read, steps = events(end.folder / LOG_FOLDER), [point.steps for point in read_result(end.folder).curve]
    kinds = {tag.partition("/")[0]: tag for tag in read.Tags()["images"]}
    assert kinds.keys() == {"refocus", "all_in_focus"}
    assert [image.step for image in read.Images(kinds["all_in_focus"])] == steps
    shown = np.asarray(Image.open(io.BytesIO(read.Images(kinds["all_in_focus"])[-1].encoded_image_string)))
    view = kinds["all_in_focus"].partition("/")[2]
    truth = np.asarray(Image.open(end.folder / "predictions" / "all_in_focus" / f"{view}.png"))
    np.testing.assert_array_equal(shown, truth)


def test_photographs_of_unknown_lens_are_shown_as_they_are_predicted(call, tmp_path: Path) -> None:
    views = [f"v{index}" for index in range(6)]
    data = write_dataset(tmp_path / "photographs", name="seal", unknown=views, blurred=views, flat=views)
    end = call(data=data, log="tensorboard")
    read, steps = events(end.folder / LOG_FOLDER), [point.steps for point in read_result(end.folder).curve]
    (tag,) = read.Tags()["images"]
    assert [image.step for image in read.Images(tag)] == steps
    shown = np.asarray(Image.open(io.BytesIO(read.Images(tag)[-1].encoded_image_string)))
    assert shown.shape == np.asarray(Image.open(end.folder / "predictions" / f"{tag}.png")).shape


def test_a_log_changes_no_bit_of_the_run(call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does it render: a method whose renderings draw random numbers would train on with others."""
    rendered = []
    predict = Evaluator._predict
    monkeypatch.setattr(Evaluator, "_predict", lambda *it: rendered.append(it[1:]) or predict(*it))
    plain = read_result(call().folder)
    without = len(rendered)
    logged = read_result(call(log="tensorboard", rerun=True).folder)
    assert decisive(plain) == decisive(logged)
    assert len(rendered) == 2 * without


def test_the_time_of_the_log_is_no_training(call, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock is set forward by an hour for each point, so that a busy machine can't be taken for it."""
    add, clock, hour = TensorBoardLog.add, time.perf_counter, 3600.0
    ahead = [0.0]

    def late(*it) -> None:
        ahead[0] += hour
        add(*it)

    monkeypatch.setattr(TensorBoardLog, "add", late)
    monkeypatch.setattr(time, "perf_counter", lambda: clock() + ahead[0])
    result = read_result(call(log="tensorboard").folder)
    assert ahead[0] == hour * len(result.curve) > 0
    assert result.scores["train_s"] < hour
    assert result.stages["evaluate during training"].wall < hour


def test_a_log_holds_one_training(call, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that was interrupted leaves points, which the next one replaces."""
    write = TensorBoardLog.add

    def interrupted(log: TensorBoardLog, point: CurvePoint) -> None:
        write(log, point)
        if point.steps > 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(TensorBoardLog, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            call(log="tensorboard")
    (left,) = (folder for folder in Path(call(dry_run=True).folder).iterdir() if folder.name == LOG_FOLDER)
    assert events(left).Tags()["scalars"]
    end = call(log="tensorboard")
    assert end.folder == left.parent
    assert scalars(events(left)) == scalars_of(read_result(end.folder).curve)
    assert not (call(rerun=True).folder / LOG_FOLDER).exists()


@pytest.mark.parametrize("before", [None, "tensorboard"])
def test_a_run_interrupted_while_it_scores_has_its_log(call, monkeypatch: pytest.MonkeyPatch, before) -> None:
    def stop(*_) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(Evaluator, "final", stop)
        with pytest.raises(KeyboardInterrupt):
            call(log=before)
    end = call(log="tensorboard")
    read = events(end.folder / LOG_FOLDER)
    assert scalars(read) == scalars_of(read_result(end.folder).curve)
    assert bool(read.Tags()["images"]) is (before is not None)


def test_a_cached_result_without_a_log_says_so(call) -> None:
    call()
    console, said = text_console()
    call(console, log="tensorboard")
    assert "--rerun" in said.getvalue().rpartition("no log")[2] and "--logdir" not in said.getvalue()


def test_non_finite_values_are_written(call) -> None:
    end = call(log="tensorboard", set=("trouble=hole",))
    values = scalars(events(end.folder / LOG_FOLDER))["scores/psnr"]
    assert values and all(np.isnan(value) for _, value in values)


def test_without_the_package_nothing_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    data = write_dataset(tmp_path / "other")
    with pytest.raises(InputError, match="tensorboard"):
        make_plan(RunSpec(method="fake", data=data, out=tmp_path / "results", log="tensorboard"), data)
