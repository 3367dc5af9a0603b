"""Pictures of test views: which are shown in strips and in the page, and the reason of those that are not; films and
refocus frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dofbench.core.images import read_image, write_png
from dofbench.evaluation.results.collecting import collect
from dofbench.reporting import pictures as reported
from dofbench.reporting.boards import gather
from dofbench.reporting.draw import OF_ERRORS, strip_lines, write_strip
from dofbench.reporting.pictures import (
    NOT_THERE,
    BoardPictures,
    KindPictures,
    Moving,
    RunPictures,
    ViewPictures,
    galleries,
    link,
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


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    write_png(tmp_path / "truth.png", np.zeros(SHAPE, np.float32))
    return tmp_path / "truth.png"


def board(*kinds: tuple[RunPictures, ...], truth: Path | None) -> BoardPictures:
    shown = tuple(KindPictures("refocus", f"kind {number}", truth, "gone", runs) for number, runs in enumerate(kinds))
    return BoardPictures("a board", (ViewPictures("view_0", "", shown),))


# ---- strips ----


def test_the_best_come_first_and_lines_are_of_six(run: Any, truth: Path, tmp_path: Path) -> None:
    pictures = board((*(run(f"m{number}", f"{20 + number}.0") for number in range(8)), run("odd", "nan")), truth=truth)
    lines = strip_lines(pictures)
    titles = [panel.title for line in lines for panel in line]
    assert titles == ["truth, kind 0", *(f"m{n}\nPSNR {20 + n}.0" for n in range(7, -1, -1)), "odd\nPSNR nan"]
    assert [len(line) for line in lines] == [6, 4] and lines[0][0].below == OF_ERRORS
    assert write_strip(tmp_path / "strip.png", pictures) is None and read_image(tmp_path / "strip.png").ndim == 3


def test_a_run_without_any_picture_has_its_reason(run: Any, truth: Path) -> None:
    """A method without a lens has no picture through one, and isn't named there: its all-in-focus picture is shown."""
    sharp, never = run("sharp", "", picture=False), run("never", "", picture=False)
    kinds = ((run("both", "30.0"), sharp, never), (run("both", "30.0"), run("sharp", "31.0"), never))
    first, second = [[panel.title for panel in line[1:]] for line in strip_lines(board(*kinds, truth=truth))]
    assert first == ["both\nPSNR 30.0", "never: why not"]
    assert second == ["sharp\nPSNR 31.0", "both\nPSNR 30.0", "never: why not"]


def test_why_there_is_no_strip(run: Any, tmp_path: Path) -> None:
    file = tmp_path / "strip.png"
    for pictures, reason in (
        (BoardPictures("a board", (), "no run has predictions"), "no run has predictions"),
        (board((run("one", "1"),), truth=None), "gone"),
    ):
        assert write_strip(file, pictures) == reason and not file.exists()


# ---- in the page ----


@pytest.fixture(scope="module")
def boards(made_report) -> list:
    return gather(collect(made_report.results).entries)


@pytest.fixture
def fern(boards: list) -> Any:
    (found,) = [board for board in boards if board.name == "fern_small"]
    return found


def test_a_page_of_many_predictions_has_fewer_views(boards: list, monkeypatch: pytest.MonkeyPatch) -> None:
    def count(shown: list[BoardPictures]) -> list[int]:
        return [len(board.views) for board in shown]

    whole = galleries(boards)
    places = sum(len(kind.runs) for board in whole for view in board.views for kind in view.kinds)
    monkeypatch.setattr(reported, "PLACES", places - 1)
    fewer = galleries(boards)
    assert all(0 < less <= more for less, more in zip(count(fewer), count(whole), strict=True))
    assert sum(count(fewer)) < sum(count(whole))
    assert all("one test view of 2" in board.omitted[-1] for board in fewer)


def test_a_truth_or_prediction_that_changed_is_not_shown(fern: Any) -> None:
    entry = fern.members[0]
    manifest, picture = Path(entry.result.data) / "dataset.json", entry.folder / "predictions/refocus/v0.png"
    before, pixels = manifest.read_text(), picture.read_bytes()
    try:
        manifest.write_text(before + " ")
        picture.write_bytes((entry.folder / "predictions/refocus/v1.png").read_bytes())
        kinds = {kind.kind: kind for kind in galleries([fern])[0].views[0].kinds}
        assert kinds["all_in_focus"].truth is None and "that it was run on" in kinds["all_in_focus"].reason
        assert "refocus" not in kinds or kinds["refocus"].runs[0].reason == NOT_THERE
        manifest.unlink()
        kinds = {kind.kind: kind for kind in galleries([fern])[0].views[0].kinds}
        assert "found no dataset" in kinds["all_in_focus"].reason
    finally:
        manifest.write_text(before)
        picture.write_bytes(pixels)


def test_pictures_are_put_into_the_reports_folder_once(tmp_path: Path) -> None:
    one, same, other, own = (tmp_path / name for name in ("a.png", "b.png", "c.png", "out/pictures/mine.png"))
    own.parent.mkdir(parents=True)
    for file, content in ((one, b"one"), (same, b"one"), (other, b"other"), (own, b"mine")):
        file.write_bytes(content)
    names = link([one, same, other], tmp_path / "out/pictures")
    assert names[one] == names[same] != names[other]
    assert {file: (tmp_path / "out" / name).read_bytes() for file, name in names.items()} == {
        one: b"one",
        same: b"one",
        other: b"other",
    }
    kept = link([other], tmp_path / "out/pictures")
    assert sorted((tmp_path / "out/pictures").iterdir()) == sorted([tmp_path / "out" / kept[other], own])


def test_pictures_are_copied_where_no_link_is_possible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError("another file system")

    monkeypatch.setattr(reported.os, "link", refuse)
    (tmp_path / "a.png").write_bytes(b"one")
    (name,) = link([tmp_path / "a.png"], tmp_path / "pictures").values()
    assert (tmp_path / name).read_bytes() == b"one" and (tmp_path / name).stat().st_nlink == 1


def test_a_film_in_a_results_folder_is_shown(fern: Any) -> None:
    film = fern.members[0].folder / "film" / "film.mp4"
    assert galleries([fern])[0].films == ()
    film.parent.mkdir()
    film.write_bytes(b"a film")
    try:
        (shown,) = galleries([fern])[0].films
        assert shown == Moving(shown.name, (film,)) and shown.name.startswith("fake")
    finally:
        film.unlink()
        film.parent.rmdir()


@pytest.fixture
def methods(made_report, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fake methods, installed."""
    monkeypatch.setenv("DOFBENCH_METHODS", str(made_report.results.parent / "methods"))


def test_refocus_frames_are_of_methods_with_a_lens_up_to_a_number(boards: list, methods: None) -> None:
    shown = galleries(boards, refocus=100)
    names = [moving.name for board in shown for moving in board.refocus]
    assert names and not any("pinhole" in name for name in names)
    assert not any("refocus frames" in line for board in shown for line in board.omitted)
    one = galleries(boards, refocus=1)
    assert sum(len(board.refocus) for board in one) == 1
    assert any("--refocus" in line for board in one for line in board.omitted)
    assert all(board.refocus == board.omitted == () for board in galleries(boards, refocus=0))


def test_why_a_run_has_no_refocus_frames(fern: Any, methods: None) -> None:
    folder = fern.members[0].folder
    (folder / "model").rename(folder / "gone")
    record = folder / "refocus" / "refocus.json"
    before = record.read_text() if record.is_file() else None
    record.unlink(missing_ok=True)
    try:
        shown = galleries([fern], refocus=9)[0]
        assert shown.refocus == () and any("the run kept no model" in line for line in shown.omitted)
    finally:
        (folder / "gone").rename(folder / "model")
        if before is not None:
            record.write_text(before)
