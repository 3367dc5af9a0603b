"""The strip of pictures: which panels it has, in which order, and what stands where there is no picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.reporting import comparison
from dofbench.reporting.gallery import BoardPictures, KindPictures, RunPictures, ViewPictures

SHAPE = (6, 8, 3)


@dataclass(frozen=True)
class Truth:
    """A picture as `gallery.Truth` reads one, or the reason why it can't."""

    trouble: str = ""

    def read(self) -> np.ndarray:
        if self.trouble:
            raise InputError("truth", self.trouble, "the picture")
        return np.zeros(SHAPE, np.float32)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """A function that makes a run with a picture and its error, or without."""

    def make(name: str, score: str, *, picture: bool = True) -> RunPictures:
        files = [tmp_path / f"{name}-{kind}.png" for kind in ("picture", "error")]
        for file in files:
            write_png(file, np.full(SHAPE, 0.5, np.float32))
        shown = files if picture else [None, None]
        scores = (("PSNR", score),) if score else ()
        return RunPictures(name, shown[0], "" if picture else "why not", shown[1], None, scores)

    return make


def board(*kinds: tuple[RunPictures, ...], truth: Any = Truth()) -> BoardPictures:
    shown = tuple(KindPictures("refocus", f"kind {number}", truth, "", runs) for number, runs in enumerate(kinds))
    return BoardPictures("a board", (ViewPictures("view_0", "", shown),), "")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[bool, str]]:
    """(whether it is a picture, its words) of all that is drawn with words, in order."""
    found: list[tuple[bool, str]] = []
    real = comparison._draw

    def draw(axes: Any, image: Any, words: str) -> None:
        found.append((image is not None, words))
        real(axes, image, words)

    monkeypatch.setattr(comparison, "_draw", draw)
    return found


def test_the_best_come_first_and_lines_are_of_six(run: Any, drawn: list[tuple[bool, str]], tmp_path: Path) -> None:
    runs = tuple(run(f"m{number}", f"{20 + number}.0") for number in range(8))
    assert comparison.write_strip(tmp_path / "strip.png", board((*runs, run("odd", "nan")))) is None
    titles = [words for picture, words in drawn if picture and words]
    assert titles == ["truth, kind 0", *(f"m{n}\nPSNR {20 + n}.0" for n in range(7, -1, -1)), "odd\nPSNR nan"]
    assert drawn[1] == (False, comparison._OF_ERRORS) and len(drawn) == 2 * 10
    wide = read_image(tmp_path / "strip.png").shape
    comparison.write_strip(tmp_path / "one.png", board(runs[:5]))
    assert wide[1] == read_image(tmp_path / "one.png").shape[1] and wide[0] > read_image(tmp_path / "one.png").shape[0]


def test_a_run_without_a_picture_is_said_where_it_has_none_at_all(
    run: Any, drawn: list[tuple[bool, str]], tmp_path: Path
) -> None:
    """A method without a lens has no picture through one, and isn't named there: the sharp picture shows it."""
    sharp, never = run("sharp", "", picture=False), run("never", "", picture=False)
    kinds = ((run("both", "30.0"), sharp, never), (run("both", "30.0"), run("sharp", "31.0"), never))
    assert comparison.write_strip(tmp_path / "strip.png", board(*kinds)) is None
    words = [said for _, said in drawn if said and said != comparison._OF_ERRORS]
    assert words == [
        "truth, kind 0", "both\nPSNR 30.0", "never: why not",
        "truth, kind 1", "sharp\nPSNR 31.0", "both\nPSNR 30.0", "never: why not",
    ]  # fmt: skip


def test_why_there_is_no_strip(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "strip.png"
    assert comparison.write_strip(file, BoardPictures("a board", (), "no run has predictions")) == (
        "no run has predictions"
    )
    assert "truth: found changed" in comparison.write_strip(file, board((run("one", "1"),), truth=Truth("changed")))
    assert comparison.write_strip(file, board((run("one", "1"),), truth=None)) == ""
    assert not file.exists()
