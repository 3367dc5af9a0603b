"""Boards that were measured in several pieces."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from benchmark_scripts import script

RUN = {"status": "ok", "preset": "cpu", "protocol": "refocus-v3", "seed": "0"}
BOARD = [
    {"method": "nerf", "dataset": "street", "psnr": "20", **RUN},
    {"method": "nerf", "dataset": "torch", "psnr": "18", **RUN},
    {"method": "nerf", "dataset": "torch@e6d3", "psnr": "17", **RUN, "protocol": "across-apertures-v1"},
    {"method": "rgs", "dataset": "street", "psnr": "25", **RUN},
]


def board(folder: Path, leaderboard: list[dict[str, str]], curves: list[dict[str, str]]) -> str:
    folder.mkdir()
    for name, rows in (("leaderboard", leaderboard), ("curves", curves)):
        with (folder / f"{name}.csv").open("w", newline="") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return str(folder)


def rows(folder: str, name: str) -> list[dict[str, str]]:
    with (Path(folder) / f"{name}.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_new_rows_take_the_place_of_the_same_run(tmp_path: Path) -> None:
    """Runs on two datasets of a scene differ in their protocol; the name that tells those apart is the board's."""
    across = {"method": "nerf", "dataset": "torch", "psnr": "19", **RUN, "protocol": "across-apertures-v1"}
    added = {"method": "pdrf", "dataset": "street", "psnr": "21", **RUN}
    whole = board(tmp_path / "board", BOARD, BOARD)
    piece = board(tmp_path / "piece", [across, added], [across, across | {"psnr": "19.5"}, added])
    assert script("join_boards").main([whole, piece]) == 0
    replaced = {**across, "dataset": "torch@e6d3"}
    assert rows(whole, "leaderboard") == [*BOARD[:2], replaced, BOARD[3], added]
    assert rows(whole, "curves") == [*BOARD[:2], replaced, replaced | {"psnr": "19.5"}, BOARD[3], added]
    once = rows(whole, "curves")
    assert script("join_boards").main([whole, piece]) == 0
    assert rows(whole, "curves") == once


def test_a_column_that_a_report_lacks_is_empty(tmp_path: Path) -> None:
    fewer = [{name: value for name, value in BOARD[0].items() if name != "psnr"}]
    whole, piece = board(tmp_path / "board", BOARD, BOARD), board(tmp_path / "piece", fewer, fewer)
    assert script("join_boards").main([whole, piece]) == 0
    assert rows(whole, "leaderboard") == [BOARD[0] | {"psnr": ""}, *BOARD[1:]]


def test_mistakes_are_one_line_and_change_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = board(tmp_path / "board", BOARD, BOARD)
    more = board(tmp_path / "more", BOARD, [BOARD[0] | {"flip": "1"}])
    crashed = board(tmp_path / "crashed", [BOARD[3] | {"status": "crashed"}], BOARD)
    twice = board(tmp_path / "twice", [*BOARD, BOARD[3]], BOARD)
    for arguments, expected in (
        ([whole], "expected a board and at least one report"),
        ([whole, str(tmp_path / "none")], "leaderboard.csv: found no such file"),
        ([whole, more], f"{Path(more) / 'curves.csv'}: found column flip"),
        ([whole, twice], "found rgs cpu street refocus-v3 0 twice"),
        ([whole, crashed], "found rgs cpu street refocus-v3 0 not ok"),
    ):
        assert script("join_boards").main(arguments) == 2
        line = capsys.readouterr().err
        assert expected in line and line.count("\n") == 1
    assert rows(whole, "leaderboard") == BOARD
