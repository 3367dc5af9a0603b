"""What README.md, reports/ and docs/ state is what their CSVs hold; and the script that compares them notices what is
wrong."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from benchmark_scripts import script
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE, NORMAL_QUANTILE

from dofbench.reporting.report_options import Report

ROOT = Path(__file__).resolve().parents[1]
check_figures, figure_numbers, figure_pages, figure_sources, figure_tables, figure_values = map(
    script, ("check_figures", "figure_numbers", "figure_pages", "figure_sources", "figure_tables", "figure_values")
)

PAGES = figure_pages.read_pages(ROOT)
WRITTEN = [page for page in PAGES if not page.generated]


def name(page: Any) -> str:
    return page.file.relative_to(ROOT).as_posix()


# ---- the pages ----


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_figure_is_that_of_its_csv(page: Any) -> None:
    assert list(check_figures.page_problems(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_figures_are_of_commits_that_there_were(page: Any) -> None:
    if not figure_sources.has_history(ROOT):
        pytest.skip("no git history here")
    assert list(figure_sources.commit_problems(page, ROOT)) == []


def test_no_page_is_forgotten() -> None:
    assert check_figures.unlisted(ROOT) == []
    assert ROOT / "README.md" in {page.file for page in PAGES}


def changed(page: Any, place: int) -> Any:
    """The page with another digit at a place of its text."""
    other = figure_pages.Page(page.folder, page.given)
    digit = str((int(page.text[place]) + 5) % 10)
    other.__dict__["text"] = page.text[:place] + digit + page.text[place + 1 :]
    other.__dict__["names"] = page.names  # rows of CSV files, which the text doesn't change
    return other


def spelled(fragment: str) -> str:
    """A pattern of the page's own text for a sentence that `plain` made of it, apart from links."""
    words = (re.escape(word).replace("_", r"[_\d]") for word in fragment.split())
    return r"\**\s+\**".join(words).join((r"\**", ""))


def last_digits(page: Any) -> list[int]:
    """Where the last digits of tied figures lie: of all sentences, and of three cells of each table."""
    places, draw = [], random.Random(0)
    for entry in page.given.get("sentence", []):
        marked = figure_numbers.plain(entry["text"])
        bare = re.sub(r"<([^<>\s][^<>]*)>", r"\1", marked)
        if found := re.search(spelled(bare), page.text):
            figures = re.findall(r"<([^<>\s][^<>]*)>", marked)
            start = found.start()
            for figure in figures:
                at = re.compile(rf"(?<![\d.]){re.escape(figure)}(?![\d])").search(page.text, start)
                assert at is not None
                places.append(start := at.end())
    lines = [(found.start(), found.group()) for found in re.finditer(r"^\|.*$", page.text, re.MULTILINE)]
    for entry in page.given.get("table", []):
        head = next(number for number, (_, line) in enumerate(lines) if line.startswith(entry["head"]))
        lines[head] = (lines[head][0], "")  # the next table of the same head is another
        cells = []
        whole = len(figure_tables.rows(entry, page.folder, page.names)) if "each" in entry else 0
        columns = ["", *entry["columns"]] if whole else entry["columns"]
        for chosen, (start, line) in zip(entry.get("rows", range(whole)), lines[head + 2 :], strict=False):
            own = chosen if isinstance(chosen, list) else columns
            bars = [bar.start() for bar in re.finditer(r"\|", line)]
            for left, right, column in zip(bars, bars[1:], own, strict=False):
                figures = list(figure_numbers.numbers(line[left + 1 : right]))
                if chosen != "" and column and figures:
                    cells.append(start + left + 1 + figures[0].end)
        places += draw.sample(cells, min(3, len(cells)))
    return [place - 1 for place in places]


@pytest.mark.parametrize("page", WRITTEN, ids=name)
def test_another_figure_on_a_page_is_noticed(page: Any) -> None:
    places = last_digits(page)
    assert places
    for place in places:
        first = next(figure_pages.problems(changed(page, place)), None)
        assert first is not None, page.text[max(0, place - 60) : place + 10]


# ---- what the script notices ----

PAGE = """# A page

By `dofbench report results --out reports/x` on a scene of 252 × 189 with seed 0.

| scene | PSNR / SSIM |
| --- | --- |
| fern | **31.39** / 0.926 |
| flower | – |

On fern it is
**0.4 dB** better than before, p < 0.05, and after 12 pairs.
"""
TIES = """
[[page]]
file = "page.md"
commits = ["abc"]
machine = "one"
not_measured = ["after 12 pairs"]
rows.fern = { csv = "board.csv", scene = "fern" }
rows.before = { csv = "board.csv", scene = "before" }
[[page.table]]
head = "| scene |"
from = { csv = "board.csv" }
rows = ["fern", { scene = "flower" }]
columns = ["", "psnr; ssim"]
[[page.sentence]]
text = "On fern it is <0.4> dB better than before, p < <0.05>"
is = ["fern.psnr - before.psnr", "under fern.p"]
"""
BOARD = """scene,psnr,ssim,p
fern,31.387,0.92625,0.03
before,30.95,0.91,
flower,,,
"""

Found = Callable[..., list[str]]


@pytest.fixture
def found(tmp_path: Path) -> Found:
    """A function that writes the page with one text in place of another, and returns what the script finds."""

    def look(old: str = "", new: str = "") -> list[str]:
        figure_values._read.cache_clear()
        for file, text in (("page.md", PAGE), ("figures.toml", TIES), ("board.csv", BOARD)):
            (tmp_path / file).write_text(text.replace(old, new, 1) if old else text)
        (page,) = figure_pages.pages_of(tmp_path / "figures.toml")
        return list(check_figures.page_problems(page))

    return look


def test_a_page_that_says_what_its_csv_says(found: Found) -> None:
    assert found() == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("31.39", "31.40", "the page says 31.40, the CSV 31.387"),
        ("31.387", "31.3", "the page says 31.39, the CSV 31.3"),
        ("**0.4 dB**", "**0.5 dB**", "stands 0 times on the page"),
        ("30.95", "30.85", "the page says 0.4, the CSV 0.537"),
        ("0.92625,0.03", "0.92625,0.06", "under fern.p: the page says 0.05, the CSV 0.06"),
        ("12 pairs.", "12 pairs of 3.", "3 in"),
        ("after 12 pairs.", "after 13 pairs.", "not_measured 'after 12 pairs': the page doesn't say so"),
        ("| flower | – |", "| flower | 30.1 |", "has 1 numbers, 'psnr; ssim' has 0"),
        ("| flower | – |\n", "", "1 rows, but 2 in figures.toml"),
        ("| flower | – |", "| flower | – |\n\n| other | 1 |\n| --- | --- |\n| a | 7 |", "7 in '7' is tied to no value"),
        ('{ scene = "flower" }', '{ scene = "bird" }', "board.csv: no row with scene bird"),
        ('csv = "board.csv", scene = "before"', 'csv = "bored.csv", scene = "before"', "bored.csv: no such file"),
        ("fern.psnr - before.psnr", "fern.psnr - before.psmr", "no column psmr; there are scene, psnr"),
        ("fern.psnr - before.psnr", "fern.psnr - open", "open: no row of that name"),
        ('"under fern.p"]', "]", "2 figures in angle brackets, but 1 values"),
        ('machine = "one"\n', "", "no machine in figures.toml"),
        ('commits = ["abc"]\n', "", "no commits in figures.toml"),
        ("dofbench report results --out", "dofbench report results --no-such", "dofbench doesn't take this"),
        ("dofbench report results --out reports/x", "python benchmarks/nothing.py", "no such script"),
        ("dofbench report results --out reports/x", "python benchmarks/scatter.py --no-such 1", "has no --no-such"),
        ("`dofbench report results --out reports/x`", "hand", "no command"),
    ],
)
def test_what_is_wrong_is_said(found: Found, old: str, new: str, problem: str) -> None:
    assert any(problem in one for one in found(old, new)), found(old, new)


WHOLE = """# A page

| method | fern | birds |
| --- | ---: | ---: |
| `two` | 1 | – |

and more, as `python benchmarks/scatter.py` says
"""
WHOLE_TIES = """
[[page]]
file = "page.md"
commits = ["abc"]
machine = "one"
rows.all = { csv = "board.csv", by = "method" }
[[page.table]]
head = "| method | fern"
each = "method"
from = { csv = "board.csv", by = "scene" }
columns = ["fern.psnr", "mean(all[name].birds)"]
digits = [1, 0]
order = "fern.psnr"
"""
WHOLE_BOARD = """method,scene,psnr,birds
one,fern,-31.37,
two,fern,31.84,12345
none,fern,,4
one,flower,40,
"""


@pytest.fixture
def whole(tmp_path: Path) -> Callable[[], Any]:
    """A function that reads a page with a table that its figures.toml describes whole."""
    for file, text in (("page.md", WHOLE), ("figures.toml", WHOLE_TIES), ("board.csv", WHOLE_BOARD)):
        (tmp_path / file).write_text(text)
    figure_values._read.cache_clear()
    return lambda: figure_pages.pages_of(tmp_path / "figures.toml")[0]


def test_a_whole_table_is_filled_in(whole: Callable[[], Any]) -> None:
    page = whole()
    (table,) = page.given["table"]
    text = figure_tables.filled(page.text, [(table["head"], figure_tables.rows(table, page.folder, page.names))])
    assert text == WHOLE.replace("| `two` | 1 | – |", "| `two` | 31.8 | 12 345 |\n| `one` | −31.4 | – |")
    page.file.write_text(text)
    assert list(check_figures.page_problems(whole())) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("31.8", "31.9", "says `two` | 31.9"),
        ("12 345", "12 346", "12 346"),
        ("| `one` | −31.4 | – |\n", "", "1 rows, but 2 in the CSV"),
        ("`one`", "`two`", "the CSV `one`"),
        ("| `one` |", "| `none` | | 4 |\n| `one` |", "3 rows, but 2 in the CSV"),
        ("and more", "and 3 more", "3 in"),
    ],
)
def test_a_whole_table_that_is_wrong(whole: Callable[[], Any], old: str, new: str, problem: str) -> None:
    text = WHOLE.replace("| `two` | 1 | – |", "| `two` | 31.8 | 12 345 |\n| `one` | −31.4 | – |")
    page = whole()
    page.file.write_text(text.replace(old, new))
    found = list(check_figures.page_problems(whole()))
    assert any(problem in one for one in found), found


def test_a_table_that_the_page_has_not() -> None:
    with pytest.raises(ValueError, match="no table '| other'"):
        figure_tables.filled(WHOLE, [("| other", [])])


def test_what_the_paper_prints() -> None:
    values = {name: figure_values.evaluate(f"paper('{name}', 'time', 'render_fps')", {}) for name in ("bags", "rgs")}
    assert values == {"bags": 332, "rgs": None}


def test_a_commit_that_never_was(tmp_path: Path) -> None:
    if not figure_sources.has_history(ROOT):
        pytest.skip("no git history here")
    page = figure_pages.Page(tmp_path, {"commits": ["0123456"]})
    assert list(figure_sources.commit_problems(page, ROOT)) == ["commit 0123456: not in the history"]
    assert not figure_sources.has_history(tmp_path)


def test_a_table_that_a_command_wrote(tmp_path: Path) -> None:
    figure_values._read.cache_clear()
    (tmp_path / "board.csv").write_text(BOARD)
    (tmp_path / "board.md").write_text("| scene | PSNR | p |\n| --- | --- | --- |\n| fern | 31.39 | 3.0 % |\n")
    given = {"file": "board.md", "csv": ["board.csv"], "tables": ["| scene |"]}
    page = figure_pages.Page(tmp_path, given, generated=True)
    assert list(figure_pages.problems(page)) == []
    page.__dict__["text"] = page.text.replace("31.39", "31.41")
    assert "31.41 in '31.41' is in none of board.csv" in next(figure_pages.problems(page))


def test_a_page_that_no_file_lists(tmp_path: Path) -> None:
    for folder in ("docs", "reports/x", "reports/leaderboard", "reports/leaderboards"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "docs" / "figures.toml").write_text('settings = ["limits.md"]\n')
    for file, text in (("limits.md", "0.3 dB"), ("guide.md", "four steps"), ("gpu.md", "it takes 3 ms")):
        (tmp_path / "docs" / file).write_text(text)
    for folder in ("x", "leaderboard", "leaderboards"):
        (tmp_path / "reports" / folder / "README.md").write_text("words alone")
    expected = ["reports/leaderboards/README.md", "reports/x/README.md", "docs/gpu.md"]
    assert check_figures.unlisted(tmp_path) == expected


def test_the_users_own_report_is_where_the_command_writes_it_and_is_not_kept() -> None:
    """So that the README's second command passes where the first has run, and no page of the project goes unchecked."""
    assert Report().out == check_figures.OWN_REPORT
    assert f"/{check_figures.OWN_REPORT.as_posix()}/" in (ROOT / ".gitignore").read_text().splitlines()


@given(number=st.floats(-1e4, 1e4), digits=st.integers(0, 4))
def test_a_figure_agrees_with_what_rounds_to_it_and_with_nothing_else(number: float, digits: int) -> None:
    said = f"{number:.{digits}f}".replace("-", "−")
    unit = 10.0**-digits
    assert figure_numbers.agrees(said, number)
    assert not figure_numbers.agrees(said, number + 1.01 * unit) and not figure_numbers.agrees(
        said, number - 1.01 * unit
    )


def test_what_counts_as_a_number() -> None:
    text = "1 137 s, 4.1e-08, −0.16 and [+0.35], a 9-view set, 3DGS, v1, llff-504, #4, `--width 504`, 0.05."
    said = [figure.said for figure in figure_numbers.numbers(figure_numbers.plain(text))]
    assert said == ["1 137", "4.1e-08", "−0.16", "+0.35", "9", "0.05"]


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("mean(all.psnr)", 31.1685),
        ("largest(all.psnr)", 31.387),
        ("all.only(scene='fern').ssim", 0.92625),
        ("count(all.where('psnr is not None and psnr > 31'))", 1),
        ("by.before.psnr", 30.95),
        ("portion(all, 'p')[0]", 1),
        ("psnr - all.only(scene='before').psnr", 31.387 - 30.95),  # of the table's row before a name of the page
    ],
)
def test_values(tmp_path: Path, expression: str, value: float) -> None:
    figure_values._read.cache_clear()
    (tmp_path / "board.csv").write_text(BOARD)
    every = figure_values.select(tmp_path, {"csv": "board.csv"})
    by = figure_values.select(tmp_path, {"csv": "board.csv", "by": "scene"})
    assert figure_values.evaluate(expression, {"all": every, "by": by, "row": by.fern, "psnr": 0.0}) == pytest.approx(
        value, rel=FLOAT64_VALUE
    )


def test_wilsons_interval_is_scipys() -> None:
    from scipy.stats import binomtest

    interval = binomtest(8, 10).proportion_ci(method="wilson")
    rows = figure_values.Rows([{"x": float(n < 8)} for n in range(10)], (), "")
    found, of, *percent = figure_values.evaluate("portion(rows, 'x')", {"rows": rows})
    assert (found, of) == (8, 10)
    assert percent == pytest.approx([100 * interval.low, 100 * interval.high], rel=NORMAL_QUANTILE)
