"""What the pages of reports/ say is what stands in the CSVs beside them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

REPORTS = Path(__file__).parents[2] / "reports"


def tables(page: Path, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its head."""
    text = page.read_text(encoding="utf-8").partition(f"{heading}\n")[2]
    (lines,) = [re.findall(r"^\|.*\|$", block, re.MULTILINE) for block in [text.partition("\n## ")[0]]]
    rows = [[cell.strip(" *") for cell in line.strip("|").split("|")] for line in lines]
    rule = next(index for index, row in enumerate(rows) if set("".join(row)) <= set("- "))
    return rows[rule + 1 :]


def records(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def agrees(said: str, known: str) -> bool:
    """Whether a figure is the number, rounded to the digits that the figure has; a dash says that there is none."""
    if said in ("–", ""):
        return not known
    digits = len(said.partition(".")[2])
    return f"{float(known):.{digits}f}" == said.replace(" ", "")


def summary(table: str, row: str, dataset: str, column: str) -> dict[str, str]:
    (found,) = (
        record
        for record in records(REPORTS / "ablations" / f"{table}-summary.csv")
        if (record["row"], record["dataset"], record["column"]) == (row, dataset, column)
    )
    return found


MEANS = ("aif_psnr", "psnr", "delta_a", "delta_f")


def labels(table: str) -> list[str]:
    return list(dict.fromkeys(record["row"] for record in records(REPORTS / "ablations" / f"{table}-summary.csv")))


def cells_of_means() -> Iterator[tuple[str, str, str, str]]:
    for table, heading, first in (
        ("table4", "## Table 4: lens, depth, adaptation", 4),
        ("table5", "## Table 5: what supervises depth", 1),
    ):
        rows = tables(REPORTS / "ablations" / "README.md", heading)
        assert len(rows) == len(labels(table))
        for cells, label in zip(rows, labels(table), strict=True):
            for column, cell in zip(MEANS, cells[first:], strict=True):
                yield table, label, column, cell


@pytest.mark.parametrize(("table", "row", "column", "cell"), list(cells_of_means()))
def test_means_of_the_ablations(table: str, row: str, column: str, cell: str) -> None:
    mean, _, spread = cell.partition(" ± ")
    known = summary(table, row, "mean", column)
    assert agrees(mean, known["mean"]) and agrees(spread, known["sd"] if spread else "")


def test_forward_models_of_the_ablations() -> None:
    rows = tables(REPORTS / "ablations" / "README.md", "## Forward models, on photographs that a lens took")
    assert len(rows) == len(labels("blur"))
    for cells, label in zip(rows, labels("blur"), strict=True):
        for cell, scene in zip(cells[1:3], ("foliage", "corridor"), strict=True):
            for said, column in zip(cell.split(" / "), ("psnr", "aif_psnr"), strict=True):
                assert agrees(said, summary("blur", label, scene, column)["mean"]), (label, scene, column)
        for said, column in zip(cells[3:6], ("delta_a", "delta_f", "disparity_error"), strict=True):
            assert agrees(said, summary("blur", label, "mean", column)["mean"]), (label, column)


def test_what_is_said_of_the_ablations() -> None:
    text = " ".join((REPORTS / "ablations" / "README.md").read_text(encoding="utf-8").split())
    rounded = {
        "all in focus (p = 0.69)": summary("table4", "#4", "mean", "aif_psnr")["p"],
        "refocused (p = 0.11)": summary("table4", "#4", "mean", "psnr")["p"],
        "instead of 0.063 (p = 0.002)": summary("table4", "#4", "mean", "delta_a")["p"],
        "0.9233 (p = 0.009;": summary("table4", "#4", "mean", "aif_ssim")["p"],
        "worth 1.1 dB refocused": str(-float(summary("blur", "scatter of Algorithm 1", "mean", "psnr")["difference"])),
        "and 1.1 dB all in": str(-float(summary("blur", "scatter of Algorithm 1", "mean", "aif_psnr")["difference"])),
    }
    for words, known in rounded.items():
        (said,) = re.findall(r"\d+\.\d+(?= dB|\)|;)", words)
        assert words in text and agrees(said, known), words
    for scene, before, after in (("corridor", "0.112", "0.042"), ("foliage", "0.088", "0.078")):
        assert f"{scene} ({before} to {after})" in text
        assert agrees(before, summary("table4", "#2", scene, "disparity_error")["mean"])
        assert agrees(after, summary("table4", "#4", scene, "disparity_error")["mean"])


@pytest.mark.parametrize(
    ("row", "method", "scene"),
    [
        ("fern", "dofgaussian", "llff_fern"),
        ("flower", "dofgaussian", "llff_flower"),
        ("Mip-Splatting, fern", "mipsplatting", "llff_fern"),
        ("Mip-Splatting, flower", "mipsplatting", "llff_flower"),
    ],
)
def test_the_board_of_fern_and_flower(row: str, method: str, scene: str) -> None:
    page = REPORTS / "llff-504" / "README.md"
    (cells,) = (cells for cells in tables(page, "# fern and flower at 504 × 378, hold 8") if cells[0] == row)
    (known,) = (
        record
        for record in records(REPORTS / "llff-504" / "leaderboard.csv")
        if (record["method"], record["dataset"], record["protocol"]) == (method, scene, "refocus-v2")
    )
    said = [*cells[1].partition(" / ")[::2], *cells[2].split(" / "), *cells[3:6], cells[6].removesuffix(" s")]
    columns = ("psnr", "ssim", "aif_psnr", "aif_ssim", "delta_a", "delta_f", "delta_r", "train_s")
    for figure, column in zip(said, columns, strict=True):
        assert agrees(figure.replace(" ", ""), known[column]), column
