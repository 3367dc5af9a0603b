"""The tables of benchmarks/lens/check.py: which cases are measured, and how mistakes are counted."""

from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from small_scene import options, training_set

from benchmarks.lens import cases as lens_cases
from benchmarks.lens import check, tables
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens


def _row(**changes):
    return {
        "case": "some",
        "kind": "grid",
        "lens": "yes",
        "share": "aperture",
        "points_px": "0.5",
        "tried": "yes",
        "shared": "aperture",
        "true_circle": "2",
        "circle": "2",
        "gain": "1",
        "error": "0.1",
        "seconds": "30",
        "trials_s": "10",
        "steps": "500",
        "status": "ok",
        **changes,
    }


def test_a_measured_case_is_not_measured_again_and_each_is_kept_at_once(tmp_path):
    file = tmp_path / "rows.csv"
    some = lens_cases.cases()[:3]
    wanted = [({"case": case.name}, case) for case in some]
    measured = []

    def measure(key, case):
        measured.append(key["case"])
        if len(measured) == 2:
            raise InputError("dataset", "no points", "some")
        if len(measured) == 3:
            raise KeyboardInterrupt
        return {"kind": case.kind, "status": "ok"}

    with pytest.raises(KeyboardInterrupt):
        check.fill(file, check.COLUMNS, wanted, measure, lambda: False)
    rows = check.read(file)
    assert [row["case"] for row in rows] == measured[:2] and "no points" in rows[1]["status"]
    check.fill(file, check.COLUMNS, wanted, measure, lambda: False)
    assert measured[3:] == [some[2].name] and len(check.read(file)) == 3


def test_no_case_begins_when_it_is_late(tmp_path):
    ticks = count()
    wanted = [({"case": case.name}, case) for case in lens_cases.cases()[:3]]
    check.fill(tmp_path / "rows.csv", check.COLUMNS, wanted, lambda *_: {}, lambda: next(ticks) >= 2)
    assert len(check.read(tmp_path / "rows.csv")) == 2


def test_cases_are_named_apart_and_kinds_take_turns():
    cases = lens_cases.cases()
    kinds = {case.kind for case in cases}
    assert len(cases) >= 80 and len({case.name for case in cases}) == len(cases)
    assert {case.kind for case in cases[: len(kinds)]} == kinds
    assert {case.lens for case in cases} == {"yes", "no", "faint", None}


def test_subsets():
    chosen = lens_cases.chosen_views
    f_numbers = [5.0, None, 14.0] * 8
    assert chosen("all", f_numbers) == list(range(24)) and chosen("half", f_numbers) == list(range(0, 24, 2))
    assert chosen("few", f_numbers) == [9, 10, 11, 12, 13, 14]
    assert chosen("f/5", f_numbers) == list(range(0, 24, 3)) and chosen("f/14 few", f_numbers) == list(range(5, 23, 3))


@pytest.mark.parametrize(
    ("changes", "points", "trial", "both"),
    [
        ({}, "no lens", "", ""),
        ({"gain": "0"}, "no lens", "no lens", "no lens"),
        ({"gain": "0.3", "error": "0.4"}, "no lens", "no lens", "no lens"),
        ({"circle": "0.2"}, "no lens", "no lens", "no lens"),
        ({"gain": "0", "points_px": "3"}, "", "no lens", ""),  # a clear estimate needs no trial
        ({"gain": "0", "points_px": ""}, "", "no lens", "no lens"),
        ({"lens": "no"}, "", "lens", "lens"),
        ({"lens": "no", "gain": "0", "points_px": "0.8"}, "lens", "", ""),
        ({"lens": "faint", "gain": "0"}, "", "", ""),
    ],
)
def test_what_counts_as_a_mistake(changes, points, trial, both):
    wrong = tables.wrong
    assert [wrong(_row(**changes), rule) for rule in ("points", "trial", "both")] == [points, trial, both]


@pytest.mark.parametrize(
    ("truth", "shared", "error"),
    [
        ("scene", "aperture", ""),
        ("aperture", "scene", "shared"),
        ("aperture", "exif", ""),
        ("exif", "aperture", "shared"),
        ("view", "aperture", "shared"),
        ("scene", "view", "apart"),
        ("view", "view", ""),
        ("", "view", ""),
        ("view", "", ""),
    ],
)
def test_what_counts_as_shared_wrongly(truth, shared, error):
    assert tables.wrongly_shared(_row(share=truth, shared=shared)) == error


def test_the_tables_count_mistakes_by_length(tmp_path):
    rows = [
        _row(),
        _row(case="lost", gain="0", share="scene", true_circle="0.9"),
        _row(case="tied", share="view", kind="other"),
        _row(case="sharp", lens="no", gain="0"),
        _row(case="broken", tried="", status="dataset: found no points"),
        _row(case="longer", steps="1000", gain="0"),
    ]
    tables.write_tables(tmp_path, rows)
    rates, circles, kinds, sharing = (
        [row for row in check.read(tmp_path / f"{name}.csv") if row.pop("steps") == "500"]
        for name in ("rates", "circles", "kinds", "sharing")
    )
    assert rates[1] == {
        "rule": "trial", "false_none": "1 of 3 (6–79 %)", "false_lens": "0 of 1 (0–79 %)", "faint_kept": "0 of 0",
    }  # fmt: skip
    assert [tuple(row.values()) for row in circles if row["one_of"] != "0" or row["several_of"] != "0"] == [
        ("0.75", "1", "1", "1", "0", "0"), ("2", "", "0", "0", "0", "2"),
    ]  # fmt: skip
    assert {(row["kind"], row["truth"], row["cases"], row["trial"]) for row in kinds} == {
        ("grid", "yes", "2", "1"), ("grid", "no", "1", "0"), ("other", "yes", "1", "1"),
    }  # fmt: skip
    assert {row["truth"]: (row["cases"], row["shared"][:6], row["apart"][:6]) for row in sharing} == {
        "scene": ("0", "–", "–"), "aperture": ("1", "0 of 1", "0 of 1"), "exif": ("0", "–", "–"),
        "view": ("1", "1 of 1", "0 of 1"),
    }  # fmt: skip


def test_training_ends_with_the_decision_whose_figures_are_kept(monkeypatch, tmp_path):
    seen = SimpleNamespace(physical_lens=PhysicalLens(10.0, 0.5, 48), has_depth=True)
    dataset = SimpleNamespace(training_views=lambda: [seen] * 3, depth=lambda view: np.array([[0.0, 4.0, 4.0, 2.0]]))
    monkeypatch.setattr(check, "load", lambda case, work: (dataset, training_set(), [0, 1, 2]))
    monkeypatch.setattr(check, "options", lambda settings, **changes: options(**changes, adaptation="off"))
    ended = []
    monkeypatch.setattr(
        check.Clock,
        "after_step",
        lambda self, step, loss, real=check.Clock.after_step: (
            ended.append((step, real(self, step, loss))) or ended[-1][1]
        ),
    )
    case = lens_cases.Case("real lens", "anything", share="view")
    row = check.decided(case, check.Settings(work=tmp_path, out=tmp_path, steps=90))
    assert set(row) <= set(check.COLUMNS) and row["tried"] in ("yes", "no") and row["status"] == "ok"
    assert row["circle"] >= 0 and row["views"] == 3
    assert row["true_circle"] == pytest.approx(10 * (4 / 48) * (1 / 2 - 1 / 4)) and row["lens"] == "faint"
    assert not ended[-1][1] and all(more for _, more in ended[:-1]) and ended[-1][0] < 90
