"""The viewer in a browser: by clicking, dragging, typing and reading pixels."""

from __future__ import annotations

import http.client
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Page, browser
from small_dataset import write_dataset

from dofbench.core.images import read_image
from dofbench.core.jobs import Outcome
from dofbench.viewing.keyframes import read_keyframes
from dofbench.viewing.view import viewing
from dofbench.viewing.view_options import View

pytestmark = pytest.mark.slow
pytest.importorskip("viser", reason="no package viser: pip install dofbench[view]")
CANVAS = 380  # px, of the window's width, left of the controls
AT_REST = "document.body.innerText.includes('at rest')"


@pytest.fixture
def page(call: Callable[..., Outcome], tmp_path: Path) -> Iterator[Page]:
    """The viewer of a run of the fake method, at rest."""
    with (
        viewing(View(what=(call().folder,), port=8400, keyframes=tmp_path / "keys.json")) as address,
        browser(webgl=True) as page,
    ):
        page.size(700, 600)
        page.open(address)
        page.wait(AT_REST)
        yield page


def pixels(page: Page, folder: Path, unlike: np.ndarray | None = None) -> np.ndarray:
    """The canvas, once a picture at rest is there. unlike: another picture than this one is waited for."""
    before = None
    for _ in range(300):
        time.sleep(0.3)
        page.picture(folder / "page.png")
        now = read_image(folder / "page.png")[200:, :CANVAS]
        still = before is not None and np.array_equal(before, now) and page.run(AT_REST)
        if still and (unlike is None or not np.array_equal(unlike, now)):
            return now
        before = now
    raise AssertionError("never at rest")


def test_a_click_focuses_and_a_drag_moves(page: Page, tmp_path: Path) -> None:
    first = pixels(page, tmp_path)
    assert first.std() > 0.02, "a picture, not an empty page"
    told = page.run("document.body.innerText")
    page.mouse("pressed", 150, 350)
    page.mouse("released", 150, 350)
    page.wait("!document.body.innerText.includes('focus at 2.86 ')")
    focused = pixels(page, tmp_path)
    assert page.run("document.body.innerText") != told, "the depth in focus is told"
    page.drag((150, 350), (190, 330))
    moved = pixels(page, tmp_path, unlike=focused)
    assert np.abs(moved - focused).mean() > 0.01
    page.wait("[...document.querySelectorAll('input')].some(one => one.value === 'free')")
    assert not [error for error in page.errors if "deprecated" not in error and "GPU stall" not in error]


def test_the_wipe_shows_another_layer_left_of_it(page: Page, tmp_path: Path) -> None:
    before = pixels(page, tmp_path)
    page.run(
        "(() => { const row = [...document.querySelectorAll('label')].find(one => one.innerText.trim() === 'wipe');"
        "let box = row.parentElement; while (!box.querySelector('input[type=text]')) box = box.parentElement;"
        "const input = box.querySelector('input[type=text]'); input.focus(); input.select(); })()"
    )
    page.call("Input.insertText", text="0.5")
    page.key("Enter")
    wiped = pixels(page, tmp_path, unlike=before)
    changed = np.abs(wiped - before).mean(axis=(0, 2))
    middle = wiped.shape[1] // 2
    assert changed[middle + 25 :].max() < changed[: middle - 25].mean(), "left alone, and the photograph differs"


def test_keyframes_are_saved_for_a_film(page: Page, tmp_path: Path) -> None:
    def press(text: str) -> None:
        page.run(f"[...document.querySelectorAll('button')].find(one => one.innerText.includes({text!r})).click()")

    page.run("[...document.querySelectorAll('*')].filter(one => one.innerText === 'Film').pop().click()")
    page.wait("[...document.querySelectorAll('button')].some(one => one.innerText.includes('add keyframe'))")
    press("add keyframe")
    page.wait("document.body.innerText.includes('1 keyframes')")
    before = pixels(page, tmp_path)
    page.drag((150, 350), (200, 330))
    pixels(page, tmp_path, unlike=before)
    press("add keyframe")
    page.wait("document.body.innerText.includes('2 keyframes')")
    press("save keyframes")
    page.wait("document.body.innerText.includes('dofbench render')")
    first, second = read_keyframes(tmp_path / "keys.json")
    assert (first.moment, second.moment) == (0, 1) and first.camera_to_world != second.camera_to_world
    assert first.half_opening == pytest.approx(5.0 / 200.0, rel=1 / 50)  # a step of the slider


def test_a_stranger_sees_nothing(call: Callable[..., Outcome]) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = View(what=(call().folder,), host="0.0.0.0", port=port, token="a" * 20)
    with viewing(settings) as address:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.request("GET", "/")
        assert connection.getresponse().status == 403
        with browser(webgl=True) as page:
            page.size(700, 600)
            page.open(address.replace("0.0.0.0", "127.0.0.1"))
            page.wait(AT_REST)


def test_it_ends_well_by_ctrl_c(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dofbench", "view", str(write_dataset(tmp_path / "data")), "--port", "8700"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        address = process.stdout.readline()
        assert address.startswith("http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
        assert "interrupted" not in process.stderr.read()
