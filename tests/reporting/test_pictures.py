"""Pictures of test views: which are shown in strips and in the page, and the reason of those that are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.evaluation.results.collecting import collect
from dofbench.reporting.boards import gather
from dofbench.reporting.draw import OF_ERRORS, strip_lines, write_strip
from dofbench.reporting.pictures import (
    NOT_THERE,
    BoardPictures,
    KindPictures,
    RunPictures,
    ViewPictures,
    gallery,
    packed,
)

SHAPE = (6, 8, 3)


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


def truth() -> np.ndarray:
    return np.zeros(SHAPE, np.float32)


def changed() -> np.ndarray:
    raise InputError("truth", "changed", "the picture")


def board(*kinds: tuple[RunPictures, ...], truth: Any = truth) -> BoardPictures:
    shown = tuple(KindPictures("refocus", f"kind {number}", truth, "gone", runs) for number, runs in enumerate(kinds))
    return BoardPictures("a board", (ViewPictures("view_0", "", shown),))


# ---- strips ----


def test_the_best_come_first_and_lines_are_of_six(run: Any, tmp_path: Path) -> None:
    pictures = board((*(run(f"m{number}", f"{20 + number}.0") for number in range(8)), run("odd", "nan")))
    lines = strip_lines(pictures)
    titles = [panel.title for line in lines for panel in line]
    assert titles == ["truth, kind 0", *(f"m{n}\nPSNR {20 + n}.0" for n in range(7, -1, -1)), "odd\nPSNR nan"]
    assert [len(line) for line in lines] == [6, 4] and lines[0][0].below == OF_ERRORS
    assert write_strip(tmp_path / "strip.png", pictures) is None and read_image(tmp_path / "strip.png").ndim == 3


def test_a_run_without_any_picture_has_its_reason(run: Any) -> None:
    """A method without a lens has no picture through one, and isn't named there: its all-in-focus picture is shown."""
    sharp, never = run("sharp", "", picture=False), run("never", "", picture=False)
    kinds = ((run("both", "30.0"), sharp, never), (run("both", "30.0"), run("sharp", "31.0"), never))
    first, second = [[panel.title for panel in line[1:]] for line in strip_lines(board(*kinds))]
    assert first == ["both\nPSNR 30.0", "never: why not"]
    assert second == ["sharp\nPSNR 31.0", "both\nPSNR 30.0", "never: why not"]


def test_why_there_is_no_strip(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "strip.png"
    for pictures, reason in (
        (BoardPictures("a board", (), "no run has predictions"), "no run has predictions"),
        (board((run("one", "1"),), truth=changed), "truth: found changed, expected the picture"),
        (board((run("one", "1"),), truth=None), "gone"),
    ):
        assert write_strip(file, pictures) == reason and not file.exists()


# ---- embedded ----


@pytest.fixture(scope="module")
def boards(made_report) -> list:
    return gather(collect(made_report.results).entries)


def test_pictures_stay_within_their_budget(boards: list) -> None:
    def count(data: list) -> tuple[int, int]:
        kinds = [kind for board in data for view in board["views"] for kind in view["kinds"].values()]
        uris = [kind["truth"] for kind in kinds]
        uris += [run[name] for kind in kinds for run in kind["runs"] for name in ("picture", "error", "resolved")]
        return sum(len(uri) for uri in uris if uri), sum(len(board["views"]) for board in data)

    shown = list(map(gallery, boards))
    whole, views = count(packed(shown).data)
    fewer = packed(shown, budget_mb=whole / 1e6 * 0.6)
    assert count(fewer.data)[0] <= whole * 0.6 and 0 < count(fewer.data)[1] < views
    none = packed(shown, budget_mb=1e-6)
    assert none.data == [] and none.said


def test_a_truth_or_prediction_that_changed_is_not_shown(boards: list) -> None:
    (fern,) = [board for board in boards if board.name == "fern_small"]
    entry = fern.members[0]
    manifest, picture = Path(entry.result.data) / "dataset.json", entry.folder / "predictions/refocus/v0.png"
    before, pixels = manifest.read_text(), picture.read_bytes()
    try:
        manifest.write_text(before + " ")
        picture.write_bytes((entry.folder / "predictions/refocus/v1.png").read_bytes())
        (shown,) = packed([gallery(fern)]).data
        kinds = shown["views"][0]["kinds"]
        assert kinds["all_in_focus"]["truth"] is None and "that it was run on" in kinds["all_in_focus"]["reason"]
        assert "refocus" not in kinds or kinds["refocus"]["runs"][0]["reason"] == NOT_THERE
        manifest.unlink()
        (shown,) = packed([gallery(fern)]).data
        assert "found no dataset.json" in shown["views"][0]["kinds"]["all_in_focus"]["reason"]
    finally:
        manifest.write_text(before)
        picture.write_bytes(pixels)
