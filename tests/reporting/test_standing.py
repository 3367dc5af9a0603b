"""What results don't prove, on every page: roles and photographers in headings, signs in tables, no mean over both."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from fake_method import fake_run
from markupsafe import escape
from page_reader import read
from report_pages import rows, table_rows
from rich.console import Console
from small_dataset import write_dataset

from dofbench.core.evidence import PHOTOGRAPHER_SAYS, PHOTOGRAPHER_WORDS, ROLE_SAYS, ROLE_WORDS
from dofbench.evaluation.results.collecting import Entry, collect
from dofbench.methods.cards import find_method
from dofbench.reporting import report_files
from dofbench.reporting.boards import NOTES, role_of, signs_of
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report

# (name of the dataset, its role, the label that states it, what photographed it); the last two state no role
SCENES = (
    ("fern", "development", "llff/fern", "scatter"),
    ("fence", "development", "thinlens/fence", "thinlens"),
    ("room", "report", "llff/room", "scatter"),
    ("attic", "report", "report/attic", "thinlens"),
    ("trex", "report", "llff/trex", "scatter"),
    ("desk", "report", "vr-project/desk", "unknown"),
    ("waves", None, None, "scatter"),
)
ORDER = ("attic", "desk", "room", "trex", "fence", "fern", "waves")


def titles(page: str) -> list[str]:
    return re.findall(r"^## (\w+), (?:refocus|photographs)-v\d$", page, re.MULTILINE)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two methods on scenes of every role, of which the preset of one is frozen; the folder of the report."""
    folder = tmp_path_factory.mktemp("standing")
    with pytest.MonkeyPatch.context() as patch:
        call = fake_run(folder, patch)
        for name, role, by, photographer in SCENES:
            lens = {"unknown": tuple(f"v{index}" for index in range(6))} if photographer == "unknown" else {}
            renderer = "scatter" if photographer == "unknown" else photographer
            data = write_dataset(folder / name, name=name, role=role, role_by=by, renderer=renderer, **lens)
            call(data=data)
            call(data=data, method="pinhole")
        call(data=folder / "room", set=("noise=0.4",))
        call(data=folder / "room", budget="5it")
        call(data=folder / "room", inputs="all-in-focus")
        freeze_fake(folder)
        patch.setattr(report_files, "write_curves", lambda *_: {})
        patch.setattr(report_files, "write_strip", lambda *_: "these tests want none")
        assert write_report(Report(folder / "results", folder / "out"), Console(file=io.StringIO()))
    return folder / "out"


def freeze_fake(folder: Path) -> None:
    from dofbench.methods.cards import find_method
    from dofbench.methods.frozen_presets import FrozenPreset, frozen_text, preset_digest

    digest = preset_digest(find_method("fake"), "quick")
    entry = FrozenPreset(commit="0" * 40, digest=digest)
    (folder / "methods" / "fake" / "frozen.toml").write_text(frozen_text("fake", {"quick": entry}))


@pytest.fixture(scope="module")
def page(report: Path) -> str:
    return (report / "leaderboard.md").read_text()


def test_report_scenes_come_first_and_lenses_before_formulas(page: str) -> None:
    assert tuple(dict.fromkeys(titles(page))) == ORDER


def test_a_heading_says_the_role_and_what_photographed(report: Path, page: str) -> None:
    html = (report / "scores.html").read_text()
    for name, role, _, photographer in SCENES:
        (about,) = re.findall(rf"^## {name}, (?:refocus|photographs)-v\d\n\n(.*)$", page, re.MULTILINE)
        assert about.startswith(f"{ROLE_SAYS[role]} {PHOTOGRAPHER_SAYS[photographer]} Scene {name};")  # type: ignore[index]
        assert str(escape(about)) in html
    sharp = page.split("## room, sharp-inputs-v3\n\n")[1]
    assert sharp.startswith(f"{ROLE_SAYS['report']} Scene room;")  # no shallow photograph is used


def board(page: str, name: str) -> str:
    return re.split(r"^## ", page.split(f"\n## {name}, ", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


@pytest.mark.parametrize("name", [name for name, *_ in SCENES])
def test_every_row_has_its_sign_and_every_sign_its_note(page: str, name: str) -> None:
    part = board(page, name)
    role = next(role for scene, role, *_ in SCENES if scene == name)
    firsts = [line.split("|")[1].strip() for line in part.splitlines() if line.startswith(("| fake", "| pinhole"))]
    assert len(firsts) >= 3  # of scores, of differences, of times to reach
    for first in firsts:
        if role == "development":
            assert first.endswith(" †")
        elif role is None:
            assert not set("†‡§¶") & set(first)
        elif "pinhole" in first:
            assert first.endswith(" ‡")
        elif "noise" in first:
            assert first.endswith(" §")
    for sign, note in NOTES.items():
        assert (note in part) is any(sign in first for first in firsts), sign


def test_the_frozen_preset_alone_has_no_sign_on_a_report_scene(page: str) -> None:
    found = {row["preset"]: row["method"] for row in table_rows(page, "room, refocus-v3") if "fake" in row["method"]}
    signs = {preset: method.removeprefix("fake") for preset, method in found.items()}
    assert (signs.pop("quick noise=0.4"), signs.pop("quick, 5it")) == (" §", " ¶")
    assert list(signs.values()) == [""]


def words(role: str, photographer: str) -> str:
    return f"{ROLE_WORDS[role]}, {PHOTOGRAPHER_WORDS[photographer]}"  # type: ignore[index]


def test_means_and_layouts_are_of_one_role_and_one_photographer(report: Path, page: str) -> None:
    means = re.findall(r"^## (Means over scenes, .*)\n\n(.*)$", page, re.MULTILINE)
    assert means == [(f"Means over scenes, refocus-v3, {words('report', 'scatter')}", "Scenes: room, trex.")]
    row = next(row for row in table_rows(page, means[0][0]) if row["method"].startswith("pinhole"))
    assert row["method"] == "pinhole ‡"
    sections = read_sections((report / "report.html").read_text())
    for kind in (("report", "thinlens"), ("report", "scatter"), ("development", "scatter")):
        assert f"Refocusing, and the learned lens, refocus-v3, {words(*kind)}" in sections
    section = sections[f"Refocusing, and the learned lens, refocus-v3, {words('report', 'scatter')}"]
    assert "mean over 2 scenes" in section and "fern" not in section


def read_sections(html: str) -> dict[str, str]:
    """Title -> text of the page's parts."""
    return dict(part.split("</h3>", 1) for part in html.split("<section><h3>")[1:])


def test_the_overview_is_marked_too(report: Path) -> None:
    html = (report / "report.html").read_text()
    glance = next(one for one in read(html).tables if one.caption.startswith("The best"))
    shown = [(cells[0][0], cells[2][0]) for cells in glance.rows if "sharp" not in cells[1][0]]
    assert tuple(dict.fromkeys(name.split()[0] for name, _ in shown if name.split()[0] != "mean")) == ORDER
    assert all(re.fullmatch(r"(\d+\.\d s of training, \d+\.\d frames/s)?", cells[7][0]) for cells in glance.rows)
    assert [name for name, _ in shown if name.startswith("mean")] == ["mean over 2 scenes ‡§¶"] * 2  # refocused, sharp
    signs = {name.split()[0]: (name.partition(" ")[2], best[-1]) for name, best in shown}
    assert signs["fern"] == signs["fence"] == ("†", "†") and signs["waves"][0] == ""
    assert signs["trex"][0] == "‡" and signs["room"][0] == "‡§¶"
    below = html.split('<section id="overview">')[1].split("</section>")[0]
    assert all(NOTES[sign] in below for sign in "†‡§¶")


def test_files_say_it(report: Path) -> None:
    table = rows(report / "leaderboard.csv")
    found = {(row["dataset"], row["method"]): (row["role"], row["photographer"], row["frozen"]) for row in table}
    assert found["fern", "fake"] == ("development", "scatter", "frozen")
    assert found["attic", "pinhole"] == ("report", "thinlens", "not frozen")
    assert found["desk", "fake"] == ("report", "unknown", "frozen")
    assert found["waves", "fake"][0] == "not stated"
    for name in ("per_view", "curves", "comparisons", "reach", "pareto", "times"):
        every = {(row["dataset"], row["role"]) for row in rows(report / f"{name}.csv")}
        means = {one for one in every if one[0].startswith("the mean")}
        # room and trex, that the scatter photographed; no mean over both roles
        averaged = name in ("comparisons", "pareto")
        assert means == ({("the mean over 2 scenes, report scene, scatter", "report")} if averaged else set())
        said = every - means
        assert said and said <= {(scene, role or "not stated") for scene, role, *_ in SCENES}, name
        assert ("fern", "development") in said and ("room", "report") in said


def test_a_run_that_died_has_the_role_of_its_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Callable
) -> None:

    data = write_dataset(tmp_path / "fern", name="fern", role="development", role_by="llff/fern")
    call(data=data)
    (entry,) = collect(tmp_path / "results").entries
    dead = Entry(entry.folder, entry.spec, entry.scene, entry.status, "died", None)
    assert role_of([dead, entry]) == "development" and role_of([dead]) is None
    assert signs_of("development", [dead]) == "†" and signs_of("report", [dead]) == "‡"
    freeze_fake(tmp_path)
    assert signs_of("report", [entry]) == signs_of("report", [replace(dead, choices=entry.choices)]) == ""
    assert signs_of("report", [dead]) == "§"  # nothing shows what it chose


def test_a_row_says_that_something_stands_in_for_a_part_of_its_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Callable
) -> None:
    call(data=write_dataset(tmp_path / "fern", name="fern", role="development", role_by="llff/fern"))
    (entry,) = collect(tmp_path / "results").entries
    _, options, _ = find_method("dofgaussian").preset("short")
    stereo = replace(entry, spec=entry.spec.model_copy(update={"method": "dofgaussian", "options": options}))
    network = entry.spec.model_copy(update={"method": "dofgaussian", "options": {**options, "depth_prior": "tuned"}})
    assert signs_of("development", [stereo]) == "†◊" and "◊" in signs_of("report", [stereo])
    assert "◊" not in signs_of("report", [replace(entry, spec=network)])
