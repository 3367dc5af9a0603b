"""`dofbench check` on results: a good one passes, every kind of tampering is named."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from dofbench.errors import InputError
from dofbench.files import sha256_file
from dofbench.harness.check import check, check_result
from dofbench.images import read_image, write_png


@pytest.fixture
def folder(call) -> Path:
    return call().folder


def edit(folder: Path, change: Callable[[dict], None]) -> None:
    data = json.loads((folder / "result.json").read_text())
    change(data)
    (folder / "result.json").write_text(json.dumps(data))


def test_a_good_result_passes(folder: Path) -> None:
    assert check_result(folder) == []
    assert check(folder.parent.parent, Console(quiet=True))


@pytest.mark.parametrize("status", ["lost", "crash"])
def test_a_failed_result_can_be_a_good_one(call, status: str) -> None:
    assert check_result(call(set=(f"trouble={status}",)).folder) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda data: data["spec"].update(seed=5), "the key is"),
        (lambda data: data["spec"].update(protocol="own-v1"), "unknown protocol 'own-v1'"),
        (lambda data: data["scores"].update(psnr=99.0), "psnr: 99 is not the mean"),
        (lambda data: data["scores"].update(delta_a=0.0), "delta_a: 0 is not the mean"),
        (lambda data: data["scores"].pop("flip"), "flip: no mean"),
        (lambda data: data.pop("machine"), "machine: Field required"),
        (lambda data: data["predictions"].update({"../../x.png": "0"}), "outside of the result's folder"),
    ],
)
def test_tampering_with_the_result_is_named(folder: Path, change: Callable, problem: str) -> None:
    edit(folder, change)
    assert any(problem in line for line in check_result(folder))


def test_another_picture_is_named(folder: Path) -> None:
    picture = folder / "predictions" / "refocus" / "v0.png"
    write_png(picture, read_image(picture) * 0.5)
    assert check_result(folder) == [
        "predictions/refocus/v0.png: not the file that was scored (its sha256 is another one)"]
    picture.unlink()
    assert check_result(folder) == ["predictions/refocus/v0.png: missing"]


def test_a_picture_with_a_forged_checksum_has_another_score(folder: Path) -> None:
    picture = folder / "predictions" / "refocus" / "v0.png"
    write_png(picture, read_image(picture) * 0.5)
    edit(folder, lambda data: data["predictions"].update({"predictions/refocus/v0.png": sha256_file(picture)}))
    (problem,) = check_result(folder)
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
