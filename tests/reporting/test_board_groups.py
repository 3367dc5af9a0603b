"""Which results share a row or a table, their means and spreads, and how methods are compared."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path

import pytest
from markupsafe import escape
from relisted import edit_json
from report_pages import notes, rows, table_rows
from rich.console import Console
from small_dataset import write_dataset
from tolerances import CSV_DIGITS

from dofbench.core.errors import InputError
from dofbench.core.evidence import PHOTOGRAPHER_WORDS
from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.evaluation.results.result import read_result
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report

MEANS = f"Means over scenes, refocus-v3, {PHOTOGRAPHER_WORDS['scatter']}"


def test_seeds_have_a_spread_and_a_failed_seed_is_not_left_out_of_a_mean(plain, call, made) -> None:
    values = [read_result(call(seed=seed).folder).scores["psnr"] for seed in (0, 1, 2)]
    _, out, _ = made()
    (row, _) = table_rows((out / "leaderboard.md").read_text(), "waves, refocus-v3")
    mean = sum(values) / 3
    spread = math.sqrt(sum((value - mean) ** 2 for value in values) / 2)
    assert row["seeds"] == "0, 1, 2 (n = 3)" and row["PSNR [dB] ↑"] == f"{mean:.2f} ± {spread:.2f}"

    file = next((out.parent / "results").rglob("*seed2*/result.json"))
    edit_json(file, lambda data: data.update(status="diverged", message="loss is nan at step 3"))
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    cell = table_rows(page, "waves, refocus-v3")[0]["PSNR [dB] ↑"]
    assert cell.startswith("diverged (1 of 3 seeds)[^") and notes(page, cell) == "loss is nan at step 3"


def test_protocols_never_share_a_table(plain, call, made) -> None:
    call()
    call(inputs="all-in-focus")
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    for protocol in ("refocus-v3", "sharp-inputs-v3"):
        methods = [row["method"] for row in table_rows(page, f"waves, {protocol}")]
        assert methods.count("fake") == 1
    sharp = table_rows(page, "waves, sharp-inputs-v3")
    assert [row["method"] for row in sharp] == ["fake"]  # no lens, so no do-nothing line
    assert not {"δ_A ↓", "PSNR [dB] ↑"} & set(sharp[0])  # no row has them: there is no such column
    below = page.split("## waves, sharp-inputs-v3")[1]
    line = re.search(r"^Not shown, as no row has it: (.*)$", below, re.MULTILINE)[1]
    assert "GMSD" in line and "no lens here);" in line and re.search(r"δ_A, δ_F, δ_R \(.*sharp photographs", line)
    assert {row["protocol"] for row in rows(out / "leaderboard.csv")} == {"refocus-v3", "sharp-inputs-v3"}


def _add_a_stage(data: dict) -> None:
    stages = data["plan"]["stages"]
    stages.append({**stages[0], "name": "normals", "runs": False, "reason": "flat"})


def test_a_forced_stage_is_no_second_seed(plain, call, made) -> None:
    """Variants are told apart by the stages that only one of them disables."""
    files = [call(inputs="all-in-focus", force_all=force_all).folder / "result.json" for force_all in (False, True)]
    for nothing in ("nothing", "nothing else"):
        _, out, _ = made()
        found = table_rows((out / "leaderboard.md").read_text(), "waves, sharp-inputs-v3")
        assert {row["preset"] for row in found} == {"quick, lens skipped", f"quick, {nothing} skipped"}
        assert {row["seeds"] for row in found} == {"0"}
        for file in files:
            edit_json(file, _add_a_stage)


def test_a_stage_that_one_scene_does_not_need_makes_no_other_variant(plain, call, made, tmp_path: Path) -> None:
    sharp = write_dataset(tmp_path / "sharp", name="ripples", in_focus=True)
    found = [read_result(call(data=data).folder) for data in (tmp_path / "data", sharp)]
    assert [one.plan["stages"][0]["runs"] for one in found] == [True, False]
    call(data=sharp, force_all=True)
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    means = {row["preset"]: row for row in table_rows(page, MEANS)}
    mean = sum(one.scores["aif_psnr"] for one in found) / 2
    assert means["quick, lens skipped"]["all-in-focus PSNR [dB] ↑"] == f"{mean:.2f}"
    assert {row["preset"] for row in table_rows(page, "ripples, refocus-v3")} - {""} == means.keys()


def test_two_versions_of_a_dataset_never_share_a_table(plain, call, made, tmp_path: Path) -> None:
    first = read_result(call().folder).spec.dataset_checksum
    write_dataset(tmp_path / "data", test=3)
    second = read_result(call().folder).spec.dataset_checksum
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    for checksum in (first, second):
        assert len(table_rows(page, f"waves@{checksum[:8]}, refocus-v3")) == 2
    assert {row["dataset"] for row in rows(out / "leaderboard.csv")} == {f"waves@{c[:8]}" for c in (first, second)}


def test_what_looks_alike_is_told_apart(plain, call, made, tmp_path: Path) -> None:
    call()
    call(budget="9it")
    code = tmp_path / "methods" / "fake" / "behaviour.py"
    code.write_text(code.read_text() + "\nCHANGED = 1\n")
    call()
    _, out, _ = made()
    presets = [row["preset"] for row in table_rows((out / "leaderboard.md").read_text(), "waves, refocus-v3")][:3]
    assert len(set(presets)) == 3
    assert "quick, 9it" in presets and all(re.fullmatch(r"quick, (9it|8it, code [0-9a-f]{8})", p) for p in presets)


def test_means_only_over_complete_sets_of_scenes(plain, call, made, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other", name="ripples", seed=1)
    scores = [read_result(call(data=data).folder).scores["psnr"] for data in (tmp_path / "data", other)]
    call(method="pinhole")
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    means = {row["method"]: row for row in table_rows(page, MEANS)}
    assert means["fake"]["PSNR [dB] ↑"] == f"{sum(scores) / 2:.2f}"
    gap = means["pinhole"]["all-in-focus PSNR [dB] ↑"]
    assert notes(page, gap) == "no mean over an incomplete set: ripples missing of 2 scenes"


def test_a_mean_over_scenes_has_the_spread_of_its_seeds(plain, call, made, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other", name="ripples", seed=1)
    scores = [
        [read_result(call(data=data, seed=seed).folder).scores["aif_psnr"] for seed in (0, 1)]
        for data in (tmp_path / "data", other)
    ]
    call(method="pinhole", seed=0)
    call(method="pinhole", seed=1, data=other)
    _, out, _ = made()
    means = {row["method"]: row for row in table_rows((out / "leaderboard.md").read_text(), MEANS)}
    by_seed = [sum(one) / 2 for one in zip(*scores, strict=True)]
    spread = abs(by_seed[0] - by_seed[1]) / math.sqrt(2)
    column = "all-in-focus PSNR [dB] ↑"
    assert means["fake"][column].strip("*") == f"{sum(by_seed) / 2:.2f} ± {spread:.2f}"
    assert means["fake"]["seeds"] == "0, 1 (n = 2)"
    # Seeds that aren't the same on every scene have no common spread.
    assert "±" not in means["pinhole"][column] and means["pinhole"]["seeds"] == "not the same on all"


@pytest.mark.slow
def test_methods_are_compared_view_by_view(plain, call, made, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", test=7)
    one = read_result(call(set=("noise=0.5",)).folder)
    other = read_result(call(set=("noise=0.05",)).folder)
    call(method="pinhole")
    call(set=("trouble=lost",))
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    rows_ = {(row[""], row["minus"]): row for row in table_rows(page, "Compared view by view")}
    assert next(iter(rows_)) == ("fake quick noise=0.05", "fake quick noise=0.5") and len(rows_) == 6
    column = "PSNR [dB] ↑"
    cell = rows_["fake quick noise=0.05", "fake quick noise=0.5"][column]
    differences = [a.scores["psnr"] - b.scores["psnr"] for a, b in zip(other.views, one.views, strict=True)]
    assert cell.startswith(f"{sum(differences) / 7:+.2f} [") and cell.endswith("], 7 of 7")
    # A pair has one p, in the score that most pairs have. All seven differences have one sign: 2 of 128 choices of
    # signs are as extreme, times the three pairs.
    tested = rows_["fake quick noise=0.05", "fake quick noise=0.5"]["all-in-focus PSNR [dB] ↑"]
    assert tested.endswith("7 of 7, p = 0.047, **better** (one seed)")
    gap = rows_["fake quick noise=0.05", "pinhole quick"][column]
    assert notes(page, gap) == "a run of the pair failed, or lacks this score"
    assert "Over 7 test views and 4 training views" in page and "## How differences are tested" in page
    table = {
        (row["preset"], row["against_preset"], row["method"], row["against_method"], row["column"]): row
        for row in rows(out / "comparisons.csv")
    }
    found = table["quick noise=0.05", "quick noise=0.5", "fake", "fake", "psnr"]
    assert float(found["difference"]) == pytest.approx(sum(differences) / 7, rel=CSV_DIGITS)
    assert (found["pairs"], found["seeds"], found["above"], found["p"], found["verdict"]) == ("7", "1", "7", "", "")
    judged = table["quick noise=0.05", "quick noise=0.5", "fake", "fake", "aif_psnr"]
    assert float(judged["p"]) == 6 / 2**7 and judged["verdict"] == "better"
    assert float(found["low"]) < float(found["difference"]) < float(found["high"])
    # What one of the two lacks is said; what no run of the board has isn't.
    lacking = table["quick noise=0.05", "quick", "fake", "pinhole", "psnr"]
    assert not lacking["difference"] and lacking["reason"] == "a run of the pair failed, or lacks this score"
    assert not {"photo_psnr", "across_psnr"} & {row["column"] for row in rows(out / "comparisons.csv")}


@pytest.mark.slow
def test_of_many_methods_each_is_compared_with_the_best_and_with_those_asked_for(plain, call, tmp_path: Path) -> None:
    for noise in range(1, 9):
        call(set=(f"noise=0.{noise}",))
    call(method="pinhole")

    def compared(**options) -> list[set[str]]:
        write_report(Report(tmp_path / "results", out=tmp_path / "report", pictures=False, **options))
        found = rows(tmp_path / "report" / "comparisons.csv")
        sides = ("method", "preset"), ("against_method", "against_preset")
        return [{" ".join(row[side] for side in pair) for pair in sides} for row in found if row["column"] == "psnr"]

    best = "fake quick noise=0.1"
    assert len(compared()) == 8 and all(best in pair for pair in compared())
    asked = compared(against="pinhole")
    assert len(asked) == 15 and all({best, "pinhole quick"} & pair for pair in asked)
    with pytest.raises(InputError, match="--against: found 'other', expected methods with results here: fake, pinhole"):
        compared(against="pinhole, other")


@pytest.mark.slow
def test_scenes_are_compared_together_where_both_have_all(plain, call, made, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", test=4)
    others = [write_dataset(tmp_path / name, name=name, seed=1, test=3) for name in ("ripples", "swell")]
    for noise in (0.5, 0.05):
        for data in (tmp_path / "data", *others):
            call(data=data, set=(f"noise={noise}",))
    call(method="pinhole")
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text().split("## Means over scenes")[1]
    (row,) = table_rows(page, "Compared view by view")
    assert "Over 10 test views" in page and row["PSNR [dB] ↑"].endswith("**better** (one seed)")
    found = [row for row in rows(out / "comparisons.csv") if row["column"] == "psnr" and "pinhole" not in row.values()]
    mean, *scenes = sorted(found, key=lambda row: not row["dataset"].startswith("the mean over 3 scenes"))
    assert len(scenes) == 3 and int(mean["pairs"]) == sum(int(row["pairs"]) for row in scenes) == 10
    assert float(mean["difference"]) == pytest.approx(
        sum(float(row["difference"]) for row in scenes) / 3, rel=CSV_DIGITS
    )


def test_a_copy_of_a_result_is_no_second_seed(plain, call, made) -> None:
    folder = call().folder
    shutil.copytree(folder, folder.with_name("backup"))
    _, out, said = made()
    assert "a copy of another result" in said
    assert len(rows(out / "leaderboard.csv")) == 1


# ---- what methods start from ----

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


@pytest.mark.parametrize("stated", [USUAL, FROM_SHALLOW, None], ids=["usual", "from shallow", "older dataset"])
def test_the_pages_say_where_points_come_from(plain, call, made, tmp_path: Path, stated: PointsRecord | None) -> None:
    write_dataset(tmp_path / "data", stated=stated)
    result = read_result(call().folder)
    assert result.plan["points"] == (None if stated is None else stated.model_dump(mode="json"))
    _, out, _ = made()
    words = points_in_words(stated)
    kind = "refocus-v3" + (", points from shallow training photographs" if stated is FROM_SHALLOW else "")
    assert words in (out / "leaderboard.md").read_text().split(f"## waves, {kind}\n")[1]
    pages = "".join(file.read_text() for file in out.glob("*.html"))
    assert pages.count(str(escape(words))) == 2


def test_datasets_with_other_points_are_not_averaged(plain, call, made, tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", stated=USUAL)
    for name in ("ripples", "rings"):
        call(data=write_dataset(tmp_path / name, name=name, stated=FROM_SHALLOW))
    edit_json(call().folder / "result.json", lambda data: data["plan"].pop("points"))  # as an older version
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    kind = "refocus-v3, points from shallow training photographs"
    assert f"## Means over scenes, {kind}" in page and "Scenes: rings, ripples." in page
    assert page.count("## Means over scenes, refocus-v3") == 1 and points_in_words(None) in page


def test_the_plan_of_a_run_says_where_points_come_from(
    call, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_dataset(tmp_path / "data", stated=FROM_SHALLOW)
    call(console=Console(width=400), dry_run=True)
    said = capsys.readouterr()
    assert points_in_words(FROM_SHALLOW) in said.out + said.err
