"""Ablation tables: which runs they need, what they show, and that no run is repeated."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fake_method import fake_run
from harness_fakes import Here
from report_pages import notes, table_rows
from rich.console import Console
from scipy import stats
from small_dataset import write_dataset
from tolerances import CSV_DIGITS

from dofbench.cli.ablate import make_tables
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError, one_line
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.result import read_result
from dofbench.reporting.sections import ASKED_HEADING
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import plan_tables
from dofbench.running.ablation_tables import read_tables, tables_of

TABLES = """\
method = "fake"

[[tables]]
id = "noise"
title = "What noise costs"
columns = ["psnr", "aif_psnr", "delta_a", "train_s"]
switches = ["noisy", "how"]
reference = "some"
source = "Nobody 2020, Table 9"
paper_data = "on their own waves"

[[tables.rows]]
label = "some"
switches = { noisy = true, how = "as it comes" }
paper = { psnr = 20.5 }
paper_scenes = { waves = { psnr = 21.5 } }

[[tables.rows]]
label = "more"
switches = { noisy = true, how = "added" }
set = { noise = 0.8 }

[[tables.rows]]
label = "pinhole"
method = "pinhole"
switches = { noisy = true, how = "as it comes" }
paper = { psnr = 12.25 }

[[tables]]
id = "again"
title = "The same once more"
columns = ["psnr"]

[[tables.rows]]
label = "as in the other"
set = { noise = 0.8 }

[[tables]]
id = "sharp"
title = "Sharp inputs"
inputs = "all-in-focus"
columns = ["psnr", "aif_psnr", "delta_a"]

[[tables.rows]]
label = "planned"

[[tables.rows]]
label = "forced"
force_all = true

[[tables]]
id = "held"
title = "Held out"
columns = ["psnr"]
assign = ["held-out"]

[[tables.rows]]
label = "ours"
"""


@pytest.fixture
def ablate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """`ablate(table="noise", …)` makes tables of the fakes; returns whether all went well, the jobs that were run,
    what was said, and the folder of tables."""
    fake_run(tmp_path, monkeypatch)
    (tmp_path / "tables.toml").write_text(TABLES)

    def call(fatal: int | None = None, **changes) -> tuple[bool, list[str], str, Path]:
        here, stream = Here(fatal), io.StringIO()
        settings = Ablate(
            **{
                "data": str(tmp_path / "data"),
                "tables": tmp_path / "tables.toml",
                "seeds": 2,
                "results": tmp_path / "results",
                "out": tmp_path / "out",
                "table": "noise",
                **changes,
            }
        )
        good = make_tables(settings, Console(file=stream, width=400), here)
        return good, here.made, stream.getvalue(), tmp_path / "out"

    return call


def rows(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(file.read_text())))


def scores(results: Path, method: str, column: str) -> list[float]:
    """The scores in the order of seeds."""
    found = {
        result.spec.seed: result.scores[column]
        for file in sorted(results.rglob(f"{method}*/result.json"))
        if (result := read_result(file))
    }
    return [found[seed] for seed in sorted(found)]


def test_a_table_of_one_dataset(ablate, tmp_path: Path) -> None:
    good, made, _, out = ablate()
    assert good and len(made) == 6
    assert [("seed0" in name) for name in made] == [True] * 3 + [False] * 3  # early output is useful
    page = (out / "noise.md").read_text()
    some, more, pinhole = table_rows(page, "waves")
    assert list(some)[:3] == ["row", "noisy", "how"] and (more["noisy"], more["how"]) == ("yes", "added")
    values = [float(row["value"]) for row in rows(out / "noise.csv") if (row["row"], row["column"]) == ("more", "psnr")]
    spread = abs(values[0] - values[1]) / math.sqrt(2)
    assert more["PSNR [dB] ↑"] == f"{sum(values) / 2:.2f} ± {spread:.2f}"
    assert notes(page, pinhole["PSNR [dB] ↑"]) == "the method has no lens to refocus with"
    # The paper's figures for this scene have a separate column.
    paper = "*paper: PSNR [dB] ↑*"
    assert some[paper] == "21.50" and pinhole[paper].startswith("–")
    assert "Nobody 2020, Table 9, on their own waves" in page
    assert "\ndofbench ablate --data" in page
    assert not re.search(r"^## Mean over", page, re.MULTILINE)


def test_a_table_of_photographs_whose_lens_nobody_knows(ablate, tmp_path: Path) -> None:
    every = [f"v{index}" for index in range(6)]
    write_dataset(tmp_path / "data", unknown=every, blurred=every[2:])
    good, made, _, out = ablate(seeds=1)
    assert good and len(made) == 3
    page = (out / "noise.md").read_text()
    assert "Trained on unknown lenses; no test lens." in page
    assert all("all-in-focus PSNR [dB] ↑" in row and "PSNR [dB] ↑" not in row for row in table_rows(page, "waves"))
    with pytest.raises(InputError, match="made with --assign held-out"):
        ablate(table="held")


def test_every_value_of_the_files_is_a_run_s(ablate, tmp_path: Path) -> None:
    _, _, _, out = ablate()
    cells = rows(out / "noise.csv")
    columns = "table row dataset seed column value status method preset options budget role"
    assert len(cells) == 3 * 2 * 4 and list(cells[0]) == columns.split()
    (noisy,) = {(row["method"], row["preset"], row["options"]) for row in cells if row["row"] == "more"}
    assert noisy == ("fake", "quick", "noise=0.8") and {row["role"] for row in cells} == {"not stated"}
    expected = scores(tmp_path / "results", "pinhole", "aif_psnr")
    found = [float(row["value"]) for row in cells if (row["row"], row["column"]) == ("pinhole", "aif_psnr")]
    assert found == pytest.approx(expected, rel=CSV_DIGITS)
    assert {row["value"] for row in cells if (row["row"], row["column"]) == ("pinhole", "psnr")} == {""}
    summary = {(row["row"], row["dataset"], row["column"]): row for row in rows(out / "noise-summary.csv")}
    assert float(summary["pinhole", "waves", "aif_psnr"]["mean"]) == pytest.approx(sum(expected) / 2, rel=CSV_DIGITS)
    assert summary["some", "mean", "psnr"]["paper"] == "20.5" and summary["more", "mean", "psnr"]["paper"] == ""
    assert summary["some", "waves", "psnr"]["paper"] == "21.5" and summary["pinhole", "waves", "psnr"]["paper"] == ""


@pytest.mark.slow
def test_means_and_differences_over_datasets(ablate, tmp_path: Path) -> None:
    others = [
        write_dataset(tmp_path / name, name=name, seed=seed, test=5)
        for seed, name in enumerate(("ripples", "swell"), 1)
    ]
    _, _, _, out = ablate(data=",".join(map(str, [tmp_path / "data", *others])))
    datasets = ("waves", "ripples", "swell")
    page = (out / "noise.md").read_text()
    values = {
        (row["row"], row["dataset"], row["seed"]): float(row["value"])
        for row in rows(out / "noise.csv")
        if row["column"] == "aif_psnr"
    }
    by_seed = [sum(values["more", dataset, seed] for dataset in datasets) / 3 for seed in "01"]
    means = {row["row"]: row for row in table_rows(page, "Mean over 3 datasets")}
    spread = abs(by_seed[0] - by_seed[1]) / math.sqrt(2)
    assert means["more"]["all-in-focus PSNR [dB] ↑"] == f"{sum(by_seed) / 2:.2f} ± {spread:.2f}"
    assert means["some"]["*paper: PSNR [dB] ↑*"] == "20.50"

    views = {}  # (row, dataset) -> seeds by views
    for row, noise in (("some", 0.1), ("more", 0.8)):
        for dataset in datasets:
            found = [
                result
                for file in sorted((tmp_path / "results" / dataset).rglob("fake*/result.json"))
                if (result := read_result(file)).spec.options.get("noise", 0.1) == noise
            ]
            views[row, dataset] = np.array([[view.scores["psnr"] for view in result.views] for result in found])
    by_view = [views["more", dataset].mean(axis=0) - views["some", dataset].mean(axis=0) for dataset in datasets]
    # The differences of all views have one sign. The rows "some" and "pinhole" use the same fake, so they have no
    # differences to test.
    assert all((one < 0).all() for one in by_view)
    shown = {row["row"]: row for row in table_rows(page, "Difference from some")}
    summary = {(row["row"], row["column"]): row for row in rows(out / "noise-summary.csv") if row["dataset"] == "mean"}
    row = summary["more", "psnr"]  # in which all rows are tested
    by_scene = [float(one.mean()) for one in by_view]
    assert float(row["difference"]) == pytest.approx(sum(by_scene) / 3, rel=CSV_DIGITS)
    assert float(row["p"]) == pytest.approx(stats.ttest_1samp(by_scene, 0).pvalue, rel=CSV_DIGITS)
    assert row["pairs"] == str(sum(map(len, by_view)))
    # All views agree, but over three scenes the difference scatters too much to be told from none.
    assert float(row["p"]) > 0.05 and row["verdict"] == ""
    assert float(row["difference_low"]) < float(row["difference"]) < 0 < float(row["difference_high"])
    assert summary["pinhole", "aif_psnr"]["p"] == summary["more", "aif_psnr"]["p"] == ""
    assert summary["more", "train_s"]["pairs"] == "6"  # by dataset and seed
    assert shown["pinhole"]["all-in-focus PSNR [dB] ↑"] == "+0.00, 0 of 12"
    assert f"p = {float(row['p']):.3f}" in shown["more"]["PSNR [dB] ↑"]
    assert shown["more"]["all-in-focus PSNR [dB] ↑"].startswith("-")
    assert shown["pinhole"]["PSNR [dB] ↑"].startswith("–")  # the row has no score to compare


def test_nothing_runs_twice(ablate) -> None:
    _, first, _, _ = ablate(table="noise,again")
    assert len(first) == 6  # the row of the second table is also in the first
    _, again, said, out = ablate(table="noise,again")
    assert again == [] and "6 runs, 6 of them cached" in said
    assert [row["row"] for row in table_rows((out / "again.md").read_text(), "waves")] == ["as in the other"]
    _, more, _, _ = ablate(seeds=3)
    assert len(more) == 3 and all("seed2" in name for name in more)


def test_an_interrupted_call_loses_nothing(ablate, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        ablate(fatal=4)
    page = (tmp_path / "out" / "noise.md").read_text()
    assert "with seeds 0, of 2 asked for" in page  # the first seed is complete, so there is a table for it
    assert "±" not in table_rows(page, "waves")[0]["PSNR [dB] ↑"]
    cells = rows(tmp_path / "out" / "noise.csv")
    unfinished = {(row["row"], row["seed"]) for row in cells if row["status"] == "not run"}
    assert unfinished == {("more", "1"), ("pinhole", "1")}
    good, made, _, out = ablate()
    assert good and len(made) == 2
    assert "with seeds 0, 1." in (out / "noise.md").read_text()


def test_a_table_that_has_just_begun(ablate, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        ablate(fatal=1)
    page = (tmp_path / "out" / "noise.md").read_text()
    some, more, _ = table_rows(page, "waves")
    assert float(some["PSNR [dB] ↑"].strip("*")) > 10 and more["PSNR [dB] ↑"].startswith("not run yet[^")


@pytest.mark.slow
def test_a_failing_cell_stops_nothing_else(ablate, tmp_path: Path) -> None:
    (tmp_path / "tables.toml").write_text(TABLES.replace("set = { noise = 0.8 }", 'set = { trouble = "lost" }', 1))
    other = write_dataset(tmp_path / "other", name="ripples", seed=1)
    good, made, said, out = ablate(data=f"{tmp_path / 'data'},{other}")
    assert not good and len(made) == 12
    assert said.count("diverged: loss is nan at step 3") == 4
    page = (out / "noise.md").read_text()
    assert table_rows(page, "waves")[1]["PSNR [dB] ↑"].startswith("diverged (2 of 2 seeds)[^")
    mean = table_rows(page, "Mean over 2 datasets")
    assert mean[1]["PSNR [dB] ↑"].startswith("diverged") and re.match(r"\**\d", mean[0]["PSNR [dB] ↑"])
    assert {row["status"] for row in rows(out / "noise.csv") if row["row"] == "more"} == {"diverged"}
    # A diverged run counts as finished: running it again would only repeat the result.
    assert ablate(data=f"{tmp_path / 'data'},{other}")[:2] == (False, [])


def test_no_mean_over_an_incomplete_set(ablate, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other", name="ripples", seed=1)
    with pytest.raises(KeyboardInterrupt):
        ablate(data=f"{tmp_path / 'data'},{other}", fatal=3)
    page = (tmp_path / "out" / "noise.md").read_text()
    some, more, pinhole = table_rows(page, "Mean over 2 datasets")
    assert re.match(r"\**\d", some["PSNR [dB] ↑"])
    assert notes(page, more["PSNR [dB] ↑"]) == "no mean over an incomplete set: ripples missing of 2 scenes"
    assert pinhole["PSNR [dB] ↑"].startswith("not run yet")


@pytest.mark.slow
def test_a_crash_is_tried_again(ablate, tmp_path: Path) -> None:
    (tmp_path / "tables.toml").write_text(TABLES.replace("set = { noise = 0.8 }", 'set = { trouble = "crash" }', 1))
    assert len(ablate()[1]) == 6
    good, made, said, out = ablate()
    assert not good and len(made) == 2
    assert "crashed: RuntimeError: something broke" in said
    assert table_rows((out / "noise.md").read_text(), "waves")[1]["PSNR [dB] ↑"].startswith("crashed (2 of 2 seeds)")


def test_code_that_changes_meanwhile_is_named(ablate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Here.run

    def changing(self, jobs, watcher):
        file = tmp_path / "methods" / "fake" / "behaviour.py"
        file.write_text(file.read_text() + "\nCHANGED = 1\n")
        return original(self, jobs, watcher)

    monkeypatch.setattr(Here, "run", changing)
    good, _, said, out = ablate(table="again")
    assert not good and "fake-quick-seed0" in said and "changed" in said
    assert table_rows((out / "again.md").read_text(), "waves")[0]["PSNR [dB] ↑"].startswith("not run yet")


def test_sharp_inputs_leave_the_lens_out_unless_forced(ablate) -> None:
    _, made, _, out = ablate(table="sharp", seeds=1)
    page = (out / "sharp.md").read_text()
    assert len(made) == 2
    planned, forced = table_rows(page, "Rows")
    assert planned["disabled by the plan"].startswith("lens: estimated CoC radius up to 0.1")
    assert planned["disabled by the plan"].endswith("; normals: a fake has none")
    assert forced["disabled by the plan"] == "normals: a fake has none"
    shown = table_rows(page, "waves")
    assert "δ_A ↓" not in shown[0]  # a column that no row has is left out, and a line says why
    assert re.search(r"^Not shown, as no row has it: δ_A \(.*sharp photographs", page, re.MULTILINE)
    assert "One seed: the spread is unknown" in page and "Trained and tested on all-in-focus images" in page


@pytest.mark.slow
def test_held_out_lenses_have_tables_of_their_own(ablate, tmp_path: Path) -> None:
    held = write_dataset(tmp_path / "apart", name="apart", assign="held-out")
    _, made, said, out = ablate(data=f"{tmp_path / 'data'},{held}", table=None, seeds=1)
    assert (out / "held.md").is_file() and "## apart" not in (out / "noise.md").read_text()
    assert (
        "## apart, held-out focus: trained on F 0.2, 0.5, 0.8 and A 0.5, 1; "
        "the test views ask for F 0.2, 0.5 and A 0.5, 1"
    ) in (out / "held.md").read_text()
    assert [row["lens of the test views"] for row in table_rows((out / "held.md").read_text(), ASKED_HEADING)] == [
        "F 0.2, A 0.5 (1 view)",
        "F 0.5, A 1 (1 view)",
        "A 0, all in focus (2 views)",
    ]
    _, _, said, _ = ablate(table=None, seeds=1)
    assert "skipping table held: needs a dataset made with --assign held-out" in said
    with pytest.raises(InputError, match="table held: found no dataset for it"):
        ablate(table="held")


def test_a_dry_run_runs_nothing(ablate, tmp_path: Path) -> None:
    good, made, said, out = ablate(dry_run=True)
    assert good and made == [] and not out.exists() and not (tmp_path / "results").exists()
    assert said.startswith("1 table with 6 cells\n6 runs, 0 of them cached\n")
    assert "to be run, for noise more: dofbench run --method fake" in said and "--set noise=0.8" in said
    ablate(seeds=1)
    _, _, said, _ = ablate(dry_run=True)
    assert said.count("cached, for noise") == 3 and re.search(r"about \d+ s to go", said)


def test_options_for_every_row(ablate, tmp_path: Path) -> None:
    ablate(set=("noise=0.3", "at=4"), seeds=1, preset="slow")
    specs = [read_result(file).spec for file in sorted((tmp_path / "results").rglob("fake*/result.json"))]
    assert sorted(spec.overrides["noise"] for spec in specs) == [0.3, 0.8]  # the row's value replaces the call's
    assert {spec.overrides["at"] for spec in specs} == {4} and {spec.preset for spec in specs} == {"slow"}


@pytest.mark.parametrize(
    ("changes", "subject"),
    [
        ({"table": "noise,other"}, "--table: found 'other', expected one of again, held, noise, sharp"),
        ({"set": ("nois=1",)}, "table noise, row some: option nois: found an unknown name"),
        ({"preset": "best"}, "table noise, row some: preset of fake: found 'best'"),
        ({"data": "nowhere"}, "nowhere: found no"),
        ({"tables": Path("none.toml")}, "none.toml: found no such file"),
    ],
)
def test_a_wrong_call_is_one_line_before_anything_runs(ablate, tmp_path: Path, changes: dict, subject: str) -> None:
    with pytest.raises(InputError, match=re.escape(subject)):
        ablate(**changes)
    assert not (tmp_path / "results").exists()


def test_an_option_that_the_code_does_not_know_is_named_with_its_row(ablate, tmp_path: Path) -> None:
    (tmp_path / "tables.toml").write_text(TABLES.replace("noise = 0.8", "nose = 0.8"))
    with pytest.raises(InputError, match="table noise, row more: option nose: found an unknown name"):
        ablate()
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('"psnr", "aif_psnr"', '"lpips", "aif_psnr"', "unknown column 'lpips'"),
        ('reference = "some"', 'reference = "none"', "reference 'none'"),
        ('label = "more"', 'label = "some"', "two rows of one label"),
        ('id = "again"', 'id = "noise"', "two tables of one id"),
        ('noisy = true, how = "added"', "noisy = true", "row more: switches noisy"),
        ('source = "Nobody 2020, Table 9"', "", "figures of a paper without the table's source"),
        ('assign = ["held-out"]', 'assign = ["held-out", "fixed"]', "expected held-out alone"),
        ('assign = ["held-out"]', 'assign = ["held"]', "assign"),
        ("force_all = true", "force = true", "Extra inputs are not permitted"),
        ("method =", "method", "no TOML"),
    ],
)
def test_a_wrong_file_of_tables_is_one_line(tmp_path: Path, old: str, new: str, problem: str) -> None:
    assert old in TABLES
    (tmp_path / "tables.toml").write_text(TABLES.replace(old, new, 1))
    with pytest.raises(InputError) as wrong:
        read_tables(tmp_path / "tables.toml")
    assert problem in str(wrong.value) and "\n" not in one_line(wrong.value)


def test_the_shipped_tables_hold_the_paper_s_figures() -> None:
    tables = {table.id: table for table in read_tables(tables_of("dofgaussian")).tables}
    assert [(row.paper["aif_psnr"], row.paper["aif_ssim_uniform7"]) for row in tables["table4"].rows] == [
        (21.31, 0.636),
        (23.05, 0.728),
        (23.59, 0.742),
        (23.42, 0.738),
        (23.97, 0.756),
    ]
    assert [tuple(row.switches.values()) for row in tables["table4"].rows] == [
        (False, False, False),
        (True, False, False),
        (True, False, True),
        (True, True, False),
        (True, True, True),
    ]
    full, same = tables["table4"].rows[-1], tables["table5"].rows[3]
    assert full.set == same.set and full.paper == same.paper  # one run is used in both tables
    fern = {row.label: row.paper_scenes.get("fern") for row in tables["table3"].rows}
    assert fern["Mip-Splatting"] == {"aif_psnr": 27.87, "aif_ssim_uniform7": 0.910}
    assert fern["DoF-Gaussian"] == {"aif_psnr": 28.23, "aif_ssim_uniform7": 0.917}


def test_an_option_that_a_preset_has_anyway_makes_no_other_run(tmp_path: Path) -> None:
    """With the real method, all of whose options are known, unlike those of a fake."""
    data = tmp_path / "data"
    make_dataset(MakeDataset(scene=str(content_folder("datasets") / "thinlens" / "foliage"), width=96, out=data))
    settings = Ablate(data=str(data), table="table4,table5,adaptation", seeds=1)
    plan = plan_tables(settings, read_tables(tables_of("dofgaussian")))
    runs = {(one.table.id, row): run for one in plan.tables for (row, _, _), run in one.runs.items()}
    assert runs["table5", "stereo"] is runs["adaptation", "one_minus_psi"]
    assert runs["table4", "#5"] is runs["table5", "fine-tuned network"]
    assert runs["table4", "#3"] is runs["table5", "none"] and runs["table4", "#2"] is not runs["table4", "#3"]
    assert len(plan.runs) == len({run.spec.key for run in plan.runs}) == 5 + 4 + 4


@pytest.mark.parametrize("option", [{"seeds": 0}, {"jobs": 0}, {"data": ","}])
def test_impossible_settings(option: dict) -> None:
    with pytest.raises(InputError):
        Ablate(**{"data": "a", **option})
