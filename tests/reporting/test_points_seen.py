"""What methods started from: in the result, below every table of a dataset, and at the top of the page."""

from __future__ import annotations

import html
from pathlib import Path

import pytest
from relisted import edit_json
from small_dataset import write_dataset

from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.evaluation.results.result import read_result

USUAL = PointsRecord(
    origin="structure from motion",
    photographs="sharp",
    views="all",
    poses="structure from motion on all views",
    tracks="unknown",
    only_test_views="given",
    count=160,
    given=160,
)
FROM_SHALLOW = USUAL.model_copy(
    update={"origin": "triangulation", "photographs": "shallow", "views": "training", "only_test_views": "left out"}
)


def below_table(page: str, heading: str) -> list[str]:
    """The lines below the first table under a heading, up to the next heading."""
    section = page.split(f"## {heading}\n", 1)[1].split("\n#", 1)[0].splitlines()
    last = max(index for index, line in enumerate(section) if line.startswith("| "))
    return section[last + 1 :]


@pytest.mark.parametrize("stated", [USUAL, FROM_SHALLOW, None], ids=["usual", "from shallow", "older dataset"])
def test_the_result_and_the_page_say_it(plain, call, made, tmp_path: Path, stated: PointsRecord | None) -> None:
    write_dataset(tmp_path / "data", stated=stated)
    result = read_result(call().folder)
    assert result.plan["points"] == (None if stated is None else stated.model_dump(mode="json"))
    _, out, _ = made()
    words = points_in_words(stated)
    kind = "refocus-v3" + (", points from shallow training photographs" if stated is FROM_SHALLOW else "")
    assert words in below_table((out / "leaderboard.md").read_text(), f"waves, {kind}")
    page = (out / "report.html").read_text()
    assert f"<dt>What methods start from</dt><dd>waves: {html.escape(words)}</dd>" in page
    assert page.count(html.escape(words)) == 2


def test_results_of_an_older_version_do_not_state_it(plain, call, made, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", stated=USUAL)
    file = call().folder / "result.json"
    edit_json(file, lambda data: data["plan"].pop("points"))
    assert "points" not in read_result(file).plan
    _, out, _ = made()
    assert points_in_words(None) in (out / "leaderboard.md").read_text()


def test_datasets_with_other_points_are_not_averaged(plain, call, made, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", stated=USUAL)
    other = write_dataset(tmp_path / "other", name="ripples", stated=FROM_SHALLOW)
    third = write_dataset(tmp_path / "third", name="rings", stated=FROM_SHALLOW)
    for data in (tmp_path / "data", other, third):
        call(data=data)
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    kind = "refocus-v3, points from shallow training photographs"
    assert f"## Means over scenes, {kind}" in page and "## Means over scenes, refocus-v3\n" not in page
    assert "Scenes: rings, ripples." in page
    said = (out / "report.html").read_text()
    assert f"waves: {html.escape(points_in_words(USUAL))}" in said
    assert f"rings, ripples: {html.escape(points_in_words(FROM_SHALLOW))}" in said


def test_the_plan_of_a_run_says_it(call, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    write_dataset(tmp_path / "data", stated=FROM_SHALLOW)
    call(console=Console(width=400), dry_run=True)
    said = capsys.readouterr()
    assert points_in_words(FROM_SHALLOW) in said.out + said.err
