"""A finished run read back: its result, its dataset, and the method as it was trained."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from called import imported_by
from small_dataset import write_dataset

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, to_8bit
from dofbench.running.load_run import load_run


def test_what_a_run_left_comes_back(call, tmp_path: Path) -> None:
    end = call()
    run = load_run(end.folder)
    assert run.result.spec.method == "fake" and run.folder == end.folder == load_run(end.folder / "result.json").folder
    assert run.dataset.checksum == run.result.spec.dataset_checksum and run.data == tmp_path / "data"
    view = run.dataset.test_views()[0]
    rendered = run.method.render(view.camera, None).image  # as trained: the fake's noise shrinks with its steps
    kept = read_image(run.prediction("all_in_focus", view.name))
    assert np.array_equal(to_8bit(rendered), to_8bit(kept))
    assert run.method is run.method  # loaded once


def test_the_dataset_may_have_moved_and_must_be_the_same(call, tmp_path: Path) -> None:
    folder = call().folder
    shutil.move(tmp_path / "data", tmp_path / "moved")
    run = load_run(folder)
    assert run.result.scores["steps"] == 8
    with pytest.raises(InputError, match="no dataset there or near the result, expected the dataset waves") as caught:
        _ = run.dataset
    assert "\n" not in str(caught.value)
    assert load_run(folder, tmp_path / "moved").dataset.name == "waves"
    assert load_run(str(folder), str(tmp_path / "moved")).dataset.name == "waves"
    with pytest.raises(InputError, match="that it was run on"):
        _ = load_run(folder, write_dataset(tmp_path / "other", seed=5)).dataset


def test_a_run_is_usable_from_any_folder(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a path relative to the current folder, which may change afterwards; and where results and data were moved
    together."""
    monkeypatch.chdir(tmp_path)
    folder = call(data=Path("data"), out=Path("results")).folder
    assert not folder.is_absolute() and load_run(folder).result.data == "data"
    run, elsewhere = load_run(folder), tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert run.dataset.name == "waves" and run.method is not None  # both read only now
    moved = elsewhere / "moved"
    moved.mkdir()
    shutil.move(tmp_path / "data", moved / "data")
    shutil.move(tmp_path / "results", moved / "results")
    monkeypatch.chdir(tmp_path)
    assert load_run(moved / folder).dataset.folder == moved / "data"


def test_a_folder_of_results_is_refused_with_one_of_them(call, tmp_path: Path) -> None:
    folder = call().folder
    with pytest.raises(InputError, match=f"1 results below, expected the folder of one, such as {folder}"):
        load_run(tmp_path / "results")


def test_another_model_or_picture_than_the_kept_one_is_refused(call) -> None:
    folder = call().folder
    (folder / "model" / "model.json").write_text("[1, {}]")
    run = load_run(folder)
    with pytest.raises(InputError, match="isn't the file that the run kept"):
        _ = run.method
    with pytest.raises(InputError, match=r"no predictions/refocus/v9\.png"):
        run.prediction("refocus", "v9")
    picture = run.prediction("refocus", "v0")
    picture.write_bytes(b"")
    with pytest.raises(InputError, match="another picture"):
        run.prediction("refocus", "v0")
    picture.unlink()
    with pytest.raises(InputError, match="no file"):
        run.prediction("refocus", "v0")
    shutil.rmtree(folder / "model")
    with pytest.raises(InputError, match="kept no model"):
        _ = load_run(folder).method


def test_a_folder_without_a_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_run(tmp_path)


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    assert not {"numpy", "pydantic", "torch"} & imported_by("import dofbench.running.load_run")
