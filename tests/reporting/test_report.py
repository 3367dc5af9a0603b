"""From results to tables, curves and pictures."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from relisted import write_again
from report_pages import notes, rows, table_rows
from small_dataset import write_dataset
from tolerances import CSV_DIGITS

from dofbench.core.errors import InputError
from dofbench.evaluation.results.columns import DEPTH
from dofbench.evaluation.results.result import Spec, read_result
from dofbench.evaluation.results.run_lock import run_lock
from dofbench.reporting import draw, report
from dofbench.reporting.curves import seconds_text
from dofbench.reporting.report_options import Report
from dofbench.reporting.sections import ASKED_HEADING
from dofbench.reporting.timing import RULE
from dofbench.running.check_results import check_result

HEADER = (
    "method,preset,dataset,scene,protocol,seed,status,psnr,ssim,ms_ssim,flip,gmsd,delta_e,aif_psnr,aif_ssim,aif_flip,"
    "delta_a,delta_f,delta_r,train_s,steps,render_fps,peak_mb,gaussians,disparity_error,depth_rel,"
    "train_cpu_s,cold_start_s,photo_psnr,photo_ssim,photo_blur_psnr,across_psnr,across_ssim,"
    "across_blurred_psnr,across_clear_psnr,unscaled_psnr,unscaled_blurred_psnr,in_focus_psnr,in_focus_blurred_psnr,"
    "exif_spread,exif_ratio,resolved,ssim_uniform7,aif_ssim_uniform7,exif_focus,exif_focus_scatter,"
    "photo_sharp_psnr,photo_sharp_ssim,photo_no_lens,photo_at_bound,photo_covered,"
    "photo_blur,photo_blur_bias,photo_sharp_blur,photo_fit_psnr,lens_energy,lens_seen,"
    "held_out_psnr,held_out_ssim,role,photographer,frozen"
)


def test_the_header_is_exact_and_one_row_a_run(plain, call, made) -> None:
    ends = [call(), call(seed=1), call(method="pinhole")]
    _, out, _ = made()
    assert (out / "leaderboard.csv").read_text().splitlines()[0] == HEADER
    table = rows(out / "leaderboard.csv")
    assert len(table) == len(ends)
    first = read_result(ends[0].folder)
    row = next(row for row in table if row["method"] == "fake" and row["seed"] == "0")
    assert (row["preset"], row["dataset"], row["protocol"], row["status"]) == ("quick", "waves", "refocus-v3", "ok")
    for column, value in first.scores.items():
        assert float(row[column]) == pytest.approx(value, rel=CSV_DIGITS)
    pinhole = next(row for row in table if row["method"] == "pinhole")
    assert pinhole["psnr"] == pinhole["delta_a"] == "" and float(pinhole["aif_psnr"]) > 20


def test_runs_with_held_out_pixels_are_rows_of_their_own(plain, call, made) -> None:
    call()
    found = read_result(call(held_out=0.2).folder)
    _, out, _ = made()
    shown = {row["preset"]: row for row in table_rows((out / "leaderboard.md").read_text(), "waves, refocus-v3")}
    without, with_them = shown["quick"], shown["quick held_out=0.2"]
    column = "held-out PSNR [dB] ↑"
    assert with_them[column].strip("*") == f"{found.scores['held_out_psnr']:.2f}" and without[column].startswith("–")


def test_the_page_explains_every_gap(plain, call, made) -> None:
    call()
    call(method="pinhole")
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    fake, pinhole, nothing = table_rows(page, "waves, refocus-v3")
    assert fake["method"] == "fake" and pinhole["method"] == "pinhole" and nothing["method"].startswith("do nothing")
    assert pinhole["PSNR [dB] ↑"].startswith("–[^")
    assert notes(page, pinhole["PSNR [dB] ↑"]) == "the method has no lens to refocus with"
    assert notes(page, pinhole["δ_A ↓"]) == "the method learns no lens"
    assert nothing["δ_A ↓"] == "0.250" and nothing["δ_F ↓"] == "0.225"
    assert nothing["PSNR [dB] ↑"].startswith("–[^")
    assert "–" not in "".join(fake.values())
    marks = re.findall(r"(?<!^)\[\^(\d+)\]", page, re.MULTILINE)
    assert set(marks) == set(re.findall(r"^\[\^(\d+)\]:", page, re.MULTILINE))


def test_a_failed_run_shows_how_it_failed(plain, call, made) -> None:
    call(set=("trouble=lost",))
    call(set=("trouble=crash",))
    _, out, _ = made()
    assert sorted(row["status"] for row in rows(out / "leaderboard.csv")) == ["crashed", "diverged"]
    assert {row["psnr"] for row in rows(out / "leaderboard.csv")} == {""}
    page = (out / "leaderboard.md").read_text()
    shown = {row["preset"]: row for row in table_rows(page, "waves, refocus-v3")}
    assert shown["quick trouble=lost"]["PSNR [dB] ↑"].startswith("diverged[^")
    assert notes(page, shown["quick trouble=lost"]["PSNR [dB] ↑"]) == "loss is nan at step 3"
    assert notes(page, shown["quick trouble=crash"]["δ_A ↓"]).startswith("RuntimeError: something broke (")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_finite_number_is_shown_as_what_it_is(plain, call, made, value: float) -> None:
    end, other = call(), call(seed=1)
    for folder, own in ((end.folder, value), (other.folder, -value)):
        data = json.loads((folder / "result.json").read_text())
        data["scores"]["flip"] = value
        data["scores"]["gmsd"] = own  # of both signs over the two seeds: their mean is no number
        write_again(folder / "result.json", data)
    _, out, _ = made()
    assert [row["flip"] for row in rows(out / "leaderboard.csv")] == [str(value)] * 2
    (row, _) = table_rows((out / "leaderboard.md").read_text(), "waves, refocus-v3")
    assert (row["FLIP ↓"], row["GMSD ↓"]) == (str(value), "nan")


def test_the_best_is_bold_and_only_there(plain, call, made) -> None:
    call(set=("noise=0.5",))
    call(set=("noise=0.01",))
    _, out, _ = made()
    good, bad, nothing = table_rows((out / "leaderboard.md").read_text(), "waves, refocus-v3")
    assert good["preset"] == "quick noise=0.01"  # sorted, best first
    assert good["PSNR [dB] ↑"].startswith("**") and not bad["PSNR [dB] ↑"].startswith("**")
    assert good["δ_A ↓"].startswith("**") and bad["δ_A ↓"].startswith("**")  # a tie
    assert not any(value.startswith("**") for value in nothing.values())
    assert not good["steps"].startswith("**")


def test_the_page_says_how_it_was_made(plain, call, made) -> None:
    end = call(set=("noise=0.2",))
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    (row,) = table_rows(page, "How these were made")
    result = read_result(end.folder)
    assert row["command"] == f"`{result.command}`" and "--set noise=0.2" in result.command
    assert row["key"] == result.key[:8] and row["machine"] == "1"
    assert f"- Machine 1: {result.machine['cpu']}" in page


def test_per_view_and_curve_tables(plain, call, made) -> None:
    result = read_result(call().folder)
    _, out, _ = made()
    views = rows(out / "per_view.csv")
    assert [(row["view"], row["split"]) for row in views] == [
        *((view.name, "test") for view in result.views),
        *((view.name, "train") for view in result.lens),
    ]
    assert float(views[0]["psnr"]) == pytest.approx(result.views[0].scores["psnr"], rel=CSV_DIGITS)
    assert float(views[-1]["aperture_estimated"]) == pytest.approx(result.lens[-1].aperture_estimated, rel=CSV_DIGITS)
    taken = rows(out / "curves.csv")
    assert list(taken[0])[:7] == ["method", "preset", "dataset", "protocol", "seed", "train_s", "steps"]
    assert [int(row["steps"]) for row in taken] == [point.steps for point in result.curve]
    assert [float(row["train_cpu_s"]) for row in taken] == pytest.approx(
        [point.train_cpu_s for point in result.curve], rel=CSV_DIGITS
    )
    assert [float(row["delta_r"]) for row in taken] == pytest.approx(
        [point.scores["delta_r"] for point in result.curve], rel=CSV_DIGITS
    )


def test_time_to_reach_a_score(plain, call, made) -> None:
    end = call()
    call(set=("trouble=lost",))
    points = read_result(end.folder).curve
    level = 20.0
    first = next(point for point in points if point.scores["psnr"] >= level)
    before = max((point.train_s for point in points if point.train_s < first.train_s), default=0.0)
    _, out, _ = made(reach="psnr=20,psnr=999")
    found = {(row["preset"], row["level"]): row for row in rows(out / "reach.csv") if row["score"] == "psnr"}
    good = found["quick", "20"]
    assert float(good["reached_s"]) == pytest.approx(first.train_s, rel=CSV_DIGITS)
    assert float(good["not_before_s"]) == pytest.approx(before, rel=CSV_DIGITS) and good["held"] == "yes"
    assert found["quick", "999"]["reached_s"] == "" and found["quick trouble=lost", "20"]["reached_s"] == ""
    page = (out / "leaderboard.md").read_text()
    below = page.split("| time to reach | PSNR ≥ 20 dB", 1)[1]
    lines = {row["time to reach"]: row for row in table_rows(f"## T\n| time to reach | PSNR ≥ 20 dB{below}", "T")}
    assert lines["fake quick"]["PSNR ≥ 20 dB"] == seconds_text(first.train_s)
    assert lines["fake quick"]["PSNR ≥ 999 dB"] == lines["fake quick trouble=lost"]["PSNR ≥ 20 dB"] == "not reached"
    assert page.count(RULE) == 1 and re.search(r"^Pareto front: fake quick from [\d.]+ s", page, re.MULTILINE)
    result = read_result(end.folder)
    times = {row["stage"]: row for row in rows(out / "times.csv") if row["preset"] == "quick"}
    assert float(times["train"]["cpu_s"]) == pytest.approx(result.stages["train"].cpu, rel=CSV_DIGITS)
    assert times["guess"]["within"] == "train" and times["guess"]["cpu_s"] == ""
    front = [row for row in rows(out / "pareto.csv") if row["score"] == "psnr"]
    assert {float(row["value"]) for row in front} <= {float(f"{p.scores['psnr']:.8g}") for p in points}
    assert max(float(row["value"]) for row in front) == max(float(f"{p.scores['psnr']:.8g}") for p in points)


def test_figures_are_there_and_linked(call, made, monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"psnr", "aif_psnr", "delta_a", "delta_f", "delta_r"} < set(draw.PLOTTED)
    monkeypatch.setattr(draw, "PLOTTED", ("psnr", "delta_f"))
    call()
    call(method="pinhole")
    written, out, _ = made()
    assert written and all(path.is_file() for path in written)
    page = (out / "leaderboard.md").read_text()
    links = re.findall(r"!\[[^]]*\]\(([^)]+)\)", page)
    assert {f"curves/waves-refocus-v3-{c}.svg" for c in ("psnr", "delta_f")} < set(links)
    assert "comparison/waves-refocus-v3.png" in links
    assert all((out / link).is_file() for link in links)
    assert {path.suffix for path in (out / "curves").iterdir()} == {".svg", ".png"}


@pytest.mark.slow
def test_the_mean_over_scenes_has_curves_too(call, made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draw, "PLOTTED", ("psnr",))
    ends = [read_result(call().folder)]
    data = write_dataset(tmp_path / "fern", name="fern", seed=1)
    ends.append(read_result(call(data=data).folder))
    call(data=data, set=("noise=0.4",))  # on one scene alone, so not in the mean
    _, out, _ = made(pictures=False, reach="psnr=1")
    assert not (out / "comparison").exists() and not (out / "pictures").exists()
    assert "<img" not in (out / "report.html").read_text()
    name = "the mean over 2 scenes, scatter"
    page = (out / "leaderboard.md").read_text().split("## Means over scenes against run time\n")[1]
    assert "![PSNR against training time](curves/the_mean_over_2_scenes_scatter-refocus-v3-psnr.svg)" in page
    assert (out / "curves" / "the_mean_over_2_scenes_scatter-refocus-v3-psnr.svg").is_file()
    last = sum(end.curve[-1].scores["psnr"] for end in ends) / 2
    front = [row for row in rows(out / "pareto.csv") if row["dataset"] == name and row["score"] == "psnr"]
    assert max(float(row["value"]) for row in front) >= float(f"{last:.8g}") and {r["method"] for r in front} == {
        "fake"
    }
    assert name not in {row["dataset"] for row in rows(out / "reach.csv")}  # a row there is of a run
    html = (out / "curves.html").read_text()
    plots = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', html)[1])["plots"]
    (mean,) = [one for one in plots if one["board"].startswith("the mean") and one["column"] == "psnr"]
    (only,) = mean["series"]
    assert only["runs"][0]["seed"] is None and only["runs"][0]["points"][-1][1] == float(f"{last:.6g}")
    assert mean["board"] == plots[0]["board"] and mean["levels"] == [1]


def test_the_same_results_give_the_same_files(call, made, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draw, "PLOTTED", ("psnr",))
    call()
    call(set=("trouble=lost",))
    (_, one, _), (_, two, _) = made("one"), made("two")
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(two) for path in two.rglob("*") if path.is_file())
    for file in files:
        assert (one / file).read_bytes() == (two / file).read_bytes(), file


def test_an_unreadable_result_is_named_and_fails_the_call(plain, call, made, tmp_path: Path) -> None:
    call()
    broken = tmp_path / "results" / "waves" / "broken"
    broken.mkdir()
    (broken / "result.json").write_text("{")
    written, out, said = made()
    assert not written and len(written.unreadable) == 1
    assert f"skipped: {broken / 'result.json'}" in said
    assert "Unreadable results" in (out / "leaderboard.md").read_text()
    assert len(rows(out / "leaderboard.csv")) == 1


def test_a_run_that_died_is_a_row_and_one_at_work_is_not(plain, call, made, tmp_path: Path) -> None:
    spec = read_result(call().folder).spec
    dead, alive = (tmp_path / "results" / "waves" / name for name in ("dead", "alive"))
    with run_lock(dead, spec.model_copy(update={"seed": 7}), "waves", "noon"):
        lock = (dead / "running.lock").read_bytes()
    (dead / "running.lock").write_bytes(lock)  # what a killed process leaves
    with run_lock(alive, spec.model_copy(update={"seed": 8}), "waves", "noon"):
        _, out, said = made()
    assert f"a run is at work there: {alive}" in said
    assert [(row["seed"], row["status"]) for row in rows(out / "leaderboard.csv")] == [("0", "ok"), ("7", "crashed")]
    page = (out / "leaderboard.md").read_text()
    assert "started noon, and the process died" in page
    assert {row["seeds"] for row in table_rows(page, "waves, refocus-v3") if row["method"] == "fake"} == {
        "0, 7 (n = 2)"
    }


def test_no_results_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        report(Report(tmp_path / "nowhere", tmp_path / "out"))
    with pytest.raises(InputError, match="no result.json"):
        report(Report(tmp_path, tmp_path / "out"))


def test_a_held_out_focus_has_a_table_of_its_own(plain, call, made, tmp_path: Path) -> None:
    held = write_dataset(tmp_path / "held", name="apart", assign="held-out", test=3)
    results = [read_result(call(data=held, seed=seed).folder) for seed in (0, 1)]
    call(data=held, method="pinhole")
    call()
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    assert "; trained on F 0.2, 0.5, 0.8 and A 0.5, 1; the test views ask for F 0.2, 0.5, 0.8 and A 0.5, 1." in page
    assert "## waves, refocus-v3\n" in page and "## Means over scenes" not in page  # a held-out focus is no other scene
    assert "## apart, refocus-v3, held-out focus\n" in page
    rows = table_rows(page, ASKED_HEADING)
    asked = {
        name: [row["lens of the test views"] for row in rows if name in row["method"]] for name in ("fake", "pinhole")
    }
    assert asked["pinhole"] == ["A 0, all in focus (3 views)"]
    assert asked["fake"] == [
        "F 0.2, A 0.5 (1 view)",
        "F 0.5, A 1 (1 view)",
        "F 0.8, A 0.5 (1 view)",
        "A 0, all in focus (3 views)",
    ]
    for row, view in zip(rows, ("v0", "v1", "v2"), strict=False):
        values = [next(one for one in result.views if one.name == view).scores["psnr"] for result in results]
        spread = abs(values[0] - values[1]) / math.sqrt(2)
        assert row["PSNR [dB] ↑"] == f"{sum(values) / 2:.2f} ± {spread:.2f}"
    sharp = [result.scores["aif_psnr"] for result in results]
    assert rows[3]["PSNR [dB] ↑"].startswith(f"{sum(sharp) / 2:.2f} ±")


def test_a_result_of_an_older_protocol_is_still_reported(plain, call, made) -> None:
    end = call()
    data = json.loads((end.folder / "result.json").read_text())
    later = (*DEPTH, "ssim_uniform7", "aif_ssim_uniform7")
    for column in later:
        del data["scores"][column]
        for view in data["views"]:
            del view["scores"][column]
    del data["plan"]["lenses"]
    data["plan"]["columns"] = [column for column in data["plan"]["columns"] if column not in later]
    for metrics in ("refocus", "all_in_focus"):
        data["protocol"][metrics].remove("ssim_uniform7")
    data["spec"]["protocol"] = data["plan"]["protocol"] = data["protocol"]["id"] = "refocus-v1"
    del data["protocol"]["depth"]
    spec = Spec.model_validate(data["spec"])
    data["key"] = spec.key
    write_again(end.folder / "result.json", data)
    assert check_result(end.folder.rename(end.folder.with_name(spec.folder.name))).problems == []
    _, out, _ = made()
    page = (out / "leaderboard.md").read_text()
    (row, _) = table_rows(page, "waves, refocus-v1")
    assert row["PSNR [dB] ↑"] and "disparity error ↓" not in row
    assert "Not shown, as no row has it: disparity error, depth AbsRel (refocus-v1 has no such score)." in page
