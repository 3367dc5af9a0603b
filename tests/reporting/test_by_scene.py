"""A report of more runs than one set of pages shows: an overview, and pages for each dataset."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from chromium import browser
from page_reader import Found, read
from report_pages import rows
from rich.console import Console

from dofbench.evaluation.comparing.score_curves import pareto_front
from dofbench.evaluation.results.collecting import collect, variant_names
from dofbench.reporting import report_files
from dofbench.reporting.boards import gather
from dofbench.reporting.curves import board_plots
from dofbench.reporting.report_files import write_report
from dofbench.reporting.report_options import Report
from dofbench.reporting.tables import Section, Table, word_headings, words

DATASETS = ("waves", "fern_small")
FEWER = 10  # runs; there are eleven


def write(results: Path, out: Path, **options: object) -> Path:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(report_files, "write_curves", lambda *_: {})
        monkeypatch.setattr(report_files, "write_strip", lambda *_: "these tests want none")
        write_report(Report(results, out, **options), Console(file=io.StringIO()))
    return out


@pytest.fixture(scope="module")
def large(made_report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same results as of `made_report`, too many for one set of pages."""
    return write(made_report.results, tmp_path_factory.mktemp("large"), page_runs=FEWER, ablation=made_report.ablation)


def tables(page: Path) -> dict[str, Found]:
    """Caption -> table."""
    return {table.caption: table for table in read(page.read_text()).tables}


def shown(table: Found) -> list[list[tuple[str, str]]]:
    """The rows without the numbers of notes, which every page counts for itself."""
    noted = ("number gap", "number failure")
    return [[(text.rstrip("0123456789") if kind in noted else text, kind) for text, kind in row] for row in table.rows]


def test_every_link_of_every_page_leads_to_a_file(large: Path) -> None:
    followed = set()
    for page in large.rglob("*.html"):
        found = read(page.read_text())
        for link in (*found.links, *(one for one in found.addresses if not one.startswith("data:"))):
            target = page if link.startswith("#") else page.parent / link
            assert target.is_file(), f"{page}: {link}"
            followed.add(target.resolve())
    for page in large.rglob("*.md"):
        for link in re.findall(r"\]\(([^)]+)\)", page.read_text()):
            assert (page.parent / link).is_file(), f"{page}: {link}"
            followed.add((page.parent / link).resolve())
    # Whoever starts at the overview finds every page and every CSV file.
    assert {file.resolve() for suffix in ("html", "csv") for file in large.rglob(f"*.{suffix}")} <= followed
    assert {file.resolve() for file in large.rglob("scenes/*/*.md")} <= followed


def test_a_scenes_pages_have_the_tables_of_a_report_of_all(large: Path, made_report) -> None:
    every = tables(made_report.out / "scores.html")
    for name in DATASETS:
        own = tables(large / "scenes" / name / "scores.html")
        shared = [caption for caption in own if name in caption]
        assert f"{name}, refocus-v3" in shared and len(shared) > 1
        for caption in shared:
            assert shown(own[caption]) == shown(every[caption]), caption
        assert not any(other in caption for other in DATASETS if other != name for caption in own)
    with_means = tables(large / "scores.html")
    means = [caption for caption in every if "means over scenes" in caption.lower()]
    assert means and all(shown(with_means[caption]) == shown(every[caption]) for caption in means)
    assert not any(caption in with_means for caption in (f"{name}, refocus-v3" for name in DATASETS))


def test_files_of_numbers_are_those_of_a_report_of_all(large: Path, made_report) -> None:
    names = {file.name for file in made_report.out.glob("*.csv")}
    assert "leaderboard.csv" in names and names == {file.name for file in large.glob("*.csv")}
    assert all((large / name).read_bytes() == (made_report.out / name).read_bytes() for name in names)
    assert not list((large / "scenes").rglob("*.csv"))
    made = rows(large / "runs.csv")
    assert len(made) == len(rows(large / "leaderboard.csv")) and all(row["command"] for row in made)


def test_pictures_are_on_the_pages_of_their_scene(large: Path, made_report) -> None:
    assert not list(large.glob("pictures/*"))
    own = {name: {file.name for file in (large / "scenes" / name / "pictures").glob("*.png")} for name in DATASETS}
    assert all(own.values())
    assert set.union(*own.values()) == {file.name for file in (made_report.out / "pictures").glob("*.png")}


def test_a_row_for_each_scene_shows_its_scores_and_leads_to_its_pages(large: Path, made_report) -> None:
    page = read((large / "report.html").read_text())
    found = tables(large / "report.html")
    every = tables(made_report.out / "scores.html")
    by_scene = next(table for caption, table in found.items() if caption.startswith("all-in-focus PSNR of each scene"))
    assert {row[0][0].split()[0] for row in by_scene.rows} == set(DATASETS)
    column = by_scene.headings.index("fake quick")
    for name, *cells in by_scene.rows:
        board = every[f"{name[0].split()[0]}, refocus-v3"]
        fake = next(row for row in board.rows if [cell for cell, _ in row[:2]] == ["fake quick".split()[0], "quick"])
        place = next(k for k, heading in enumerate(board.headings) if heading.startswith("all-in-focus PSNR"))
        assert cells[column - 1][0].partition(",")[0] == fake[place][0].partition(",")[0]
    assert {f"scenes/{name}/report.html" for name in DATASETS} <= set(page.links)
    assert any("What noise costs" in text for text in page.texts)  # the ablation


def test_what_an_earlier_report_had_is_gone(made_report, tmp_path: Path) -> None:
    out = write(made_report.results, tmp_path, page_runs=FEWER)
    (out / "scenes" / "mine.txt").write_text("a user's own file")
    gone = out / "scenes" / "of_before"
    gone.mkdir()
    (gone / "report.html").write_text("the page of a dataset that is no longer there")
    write(made_report.results, tmp_path, page_runs=FEWER)
    assert not gone.exists() and (out / "scenes" / "waves" / "report.html").is_file()
    write(made_report.results, tmp_path)
    assert [file.name for file in (out / "scenes").rglob("*") if file.is_file()] == ["mine.txt"]
    assert list(out.glob("pictures/*"))
    write(made_report.results, tmp_path, page_runs=FEWER)
    assert not list(out.glob("pictures/*"))


def test_merged_results_count_once(made_report, large: Path, tmp_path: Path) -> None:
    out = write(made_report.results, tmp_path, page_runs=FEWER, merge=(made_report.results,))
    assert (out / "leaderboard.csv").read_bytes() == (large / "leaderboard.csv").read_bytes()
    page = Path("scenes/waves/scores.html")
    assert (out / page).read_bytes() == (large / page).read_bytes()


def test_one_dataset_has_one_set_of_pages(made_report, tmp_path: Path) -> None:
    """It would be on one page of its own: instead its tables end, and say what has the rest."""
    out = write(made_report.results / "fern_small", tmp_path, page_runs=1)
    assert not (out / "scenes").exists()
    runs = tables(out / "runs.html")["How each run was made"]
    assert len(runs.rows) == 1 < len(rows(out / "runs.csv"))
    assert "runs.csv" in (out / "runs.html").read_text()


@pytest.mark.parametrize(("own", "theirs", "most"), [(5, 0, 3), (5, 2, 3), (3, 2, 3), (0, 2, 3)])
def test_a_table_ends_before_the_papers_rows(own: int, theirs: int, most: int) -> None:
    whole = tuple((words(f"row {number}"),) for number in range(own + theirs))
    table = Table("of words", word_headings("name"), whole, theirs=theirs, rest="all.csv")
    (first,) = Section("above", sections=(Section("within", tables=(table,)),)).first(most).sections[0].tables
    assert first.rows == whole[: min(own, most)] + whole[own:]
    assert (first == table) is (own <= most)
    assert any(f"{most} of {own}" in line and "all.csv" in line for line in first.notes) is (own > most)


def test_a_plot_of_fewer_curves_keeps_its_front(made_report) -> None:
    entries = collect(made_report.results).entries
    plots = board_plots(gather(entries), variant_names(entries), {})
    most = max(plots, key=lambda plot: len(plot.series))
    assert len(most.series) > 2
    front = {most.series[point.series].variant for point in most.front}
    few = most.best(len(front))
    assert {one.variant for one in few.series} == front and few.whole == len(most.series)
    higher = most.higher_is_better
    assert few.front == pareto_front([one.median for one in few.series], higher_is_better=higher)
    assert most.best(len(most.series)) is most


def test_the_pages_work_in_a_browser(large: Path) -> None:
    with browser() as page:
        for width in (1280, 360):
            page.size(width, 900, phone=width < 500)
            for file in (*large.glob("*.html"), *(large / "scenes" / "waves").glob("*.html")):
                page.open(file)
                assert page.run("[innerWidth, document.documentElement.scrollWidth]") == [width, width], file
        page.open(large / "report.html")
        page.run("document.querySelector('nav.scenes a[href*=waves]').click()")
        page.wait("location.pathname.endsWith('/scenes/waves/report.html') && document.readyState === 'complete'")
        page.wait("document.querySelector('.kind.shown img.picture')?.naturalWidth > 0")
        page.run(
            "[...document.querySelectorAll('header a')].find((a) => a.textContent === 'Error against time').click()"
        )
        page.wait(
            "location.pathname.endsWith('/scenes/waves/curves.html') && document.querySelector('#chart svg') !== null"
        )
        page.run("[...document.querySelectorAll('header a')].find((a) => a.textContent === 'All scenes').click()")
        page.wait("document.querySelector('nav.scenes') !== null")
        assert page.errors == []
