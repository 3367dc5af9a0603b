"""The page of own photographs: what it holds, that its files are there, and that its wipe works in a browser."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from chromium import browser

from dofbench.core.images import read_image, to_8bit
from dofbench.core.jobs import Outcome
from dofbench.core.progress import Silent
from dofbench.running.load_run import load_run
from dofbench.viewing import own_page as module
from dofbench.viewing.own_page import own_page, shown_views

Call = Callable[..., Outcome]


@pytest.fixture(autouse=True)
def short_film(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FRAMES", 3)


def made(call: Call, tmp_path: Path, **changes) -> tuple[Path, str]:
    run = load_run(call(**changes).folder)
    page = own_page(run, tmp_path / "page", tmp_path / "missing.html", Silent())
    return page, page.read_text()


def test_every_test_view_is_shown_all_in_focus_beside_its_photograph(call: Call, tmp_path: Path) -> None:
    page, text = made(call, tmp_path)
    run = load_run(call().folder)
    views = shown_views(run.dataset)
    assert {view.name for view in run.dataset.test_views()} <= {view.name for view in views}
    assert any(view.split == "train" for view in views)
    for number, view in enumerate(views, start=1):
        sharp = read_image(page.parent / "pictures" / f"{number:02d}-all-in-focus.png")
        expected = np.clip(run.method.render(view.camera, None).image, 0, 1)
        assert np.array_equal(to_8bit(sharp), to_8bit(expected))
        photograph = read_image(page.parent / "pictures" / f"{number:02d}-photograph.png")
        assert np.array_equal(photograph, run.dataset.image(view))
    for link in re.findall(r'(?:src|href)="([^"]+)"', text):
        assert (page.parent / link).is_file(), link
    assert "missing.html" not in text and text.index('class="wipe"') < text.index("film/") < text.index("<table>")


def test_a_sharp_set_says_that_no_lens_was_found(call: Call, tmp_path: Path) -> None:
    _, with_lens = made(call, tmp_path)
    _, without = made(call, tmp_path, set=("trouble=no lens",))
    assert "No lens was found" in without and "No lens was found" not in with_lens


def test_a_film_of_an_earlier_run_is_replaced(call: Call, tmp_path: Path) -> None:
    page, _ = made(call, tmp_path)
    first = (page.parent / "film" / "frames" / "0001.png").read_bytes()
    made(call, tmp_path, set=("noise=0.4",))
    assert (page.parent / "film" / "frames" / "0001.png").read_bytes() != first


@pytest.mark.slow
def test_the_wipe_follows_the_mouse(call: Call, tmp_path: Path) -> None:
    page_file, _ = made(call, tmp_path)
    with browser() as page:
        page.size(800, 800)
        page.open(page_file)
        box = page.run("JSON.stringify(document.querySelector('.wipe').getBoundingClientRect())")
        place = json.loads(box)
        shots = []
        for share in (0.02, 0.98):
            page.mouse("moved", place["x"] + share * place["width"], place["y"] + place["height"] / 2)
            page.picture(tmp_path / "shot.png")
            shots.append(read_image(tmp_path / "shot.png"))
        middle = int(place["y"] + place["height"] / 2), int(place["x"] + place["width"] / 2)
        around = slice(middle[0] - 60, middle[0] + 60), slice(middle[1] - 60, middle[1] + 60)
        assert np.abs(shots[0][around] - shots[1][around]).mean() > 0.01
        assert not page.errors
