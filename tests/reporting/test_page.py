"""The report's pages as files: well-formed, without network, and in agreement with the results."""

from __future__ import annotations

import csv
import json
import math
import re
from html import unescape
from pathlib import Path

import pytest
from page_reader import Reader, read
from report_pages import table_rows
from tolerances import PRINTED_MEAN

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.result import Result, read_result
from dofbench.methods.cards import find_method
from dofbench.reporting import layouts
from dofbench.reporting.ablation import read_documents
from dofbench.reporting.boards import gather
from dofbench.reporting.paper import paper_figures
from dofbench.reporting.render import Footnotes, html_environment
from dofbench.reporting.tables import Cell, Heading, Section, Table, number

QUICK = "quick"


@pytest.fixture(scope="module")
def readers(made_report) -> dict[str, Reader]:
    """Each page, by its name."""
    return {name: read(page) for name, page in made_report.pages.items()}


@pytest.fixture(scope="module")
def reader(readers: dict[str, Reader]) -> Reader:
    """The tables and texts of all pages."""
    found = Reader()
    for one in readers.values():
        found.tables += one.tables
        found.texts += one.texts
    return found


def of(made_report, method: str, **spec) -> Result:
    """The one result of a method with this in its spec."""
    results = [read_result(path) for path in sorted(made_report.results.rglob("result.json"))]
    (found,) = [
        one
        for one in results
        if one.spec.method == method and all(getattr(one.spec, name) == value for name, value in spec.items())
    ]
    return found


def shown(*sections: Section) -> str:
    """The sections as the page shows them."""
    template = (
        "{% import 'blocks.html.j2' as html with context %}{% for one in sections %}{{ html.section(one) }}{% endfor %}"
    )
    return html_environment().from_string(template).render(sections=sections, notes=Footnotes())


# ---- self-contained ----


def test_every_element_is_closed_and_every_link_leads_somewhere(readers: dict[str, Reader]) -> None:
    assert set(readers) == {"report", "curves", "scores", "runs"}
    for one in readers.values():
        assert len(set(one.ids)) == len(one.ids)
        within = [link for link in one.links if link.startswith("#")]
        assert within and all(link[1:] in one.ids for link in within)
        assert {link for link in one.links if link not in within} == {f"{name}.html" for name in readers}


def test_nothing_is_fetched_from_elsewhere(made_report, readers: dict[str, Reader]) -> None:
    for name, page in made_report.pages.items():
        addresses = [address for address in readers[name].addresses if not address.startswith("data:")]
        assert all((made_report.out / address).is_file() for address in addresses)
        assert all(address.startswith("pictures/") for address in addresses) and bool(addresses) is (name == "report")
        urls = re.findall(r"https?://[^\s\"'<>)]+", page)
        outside = [found for found in urls if found != "http://www.w3.org/2000/svg"]
        assert outside == []  # that one is the name of a namespace, which nothing fetches
        assert not re.search(r"@import|url\((?!data:)|XMLHttpRequest|fetch\(|\bimport\(|<script[^>]+src=", page)
        assert "default-src 'none'" in page


def test_the_data_are_strict_json(readers: dict[str, Reader]) -> None:
    def refused(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    data = json.loads(readers["curves"].data, parse_constant=refused)
    assert set(data) == {"plots"} and data["plots"]


def test_text_of_results_can_not_become_markup() -> None:
    wicked = '<script>alert("x")</script>&'
    cells = (number(1.0, wicked), Cell(wicked, "gap", reason=wicked), Cell("x", code=(wicked,), below=wicked))
    headings = tuple(Heading(wicked, wicked, wicked) for _ in cells)
    table = Table(wicked, headings, (cells,), below=(wicked,))
    html = shown(Section(wicked, (wicked,), (table,), command=wicked, items=(wicked,), id=wicked))
    assert "<script" not in html and html.count("&lt;script&gt;") >= 16
    assert read(html)


# ---- content ----


def test_no_column_is_empty(reader: Reader) -> None:
    assert len(reader.tables) > 8
    for one in reader.tables:
        for index, heading in enumerate(one.headings if one.rows else []):
            cells = [row[index] for row in one.rows]
            assert any(text and "gap" not in kind for text, kind in cells), (one.caption, heading)


def test_which_is_best_by_how_much_and_how_sure(made_report, reader: Reader) -> None:
    glance = next(one for one in reader.tables if one.caption.startswith("The best"))
    row = next(cells for cells in glance.rows if cells[0][0] == "waves" and cells[1][0].startswith("refocus"))
    found = {heading: text for heading, (text, _) in zip(glance.headings, row, strict=True)}
    ours = {"dataset": "waves", "protocol": "refocus-v3"}
    best, other = (
        [of(made_report, "fake", seed=seed, overrides=overrides, **ours).scores["psnr"] for seed in (0, 1, 2)]
        for overrides in ({}, {"noise": 0.4})
    )
    ahead = (sum(best) - sum(other)) / 3
    assert found["best"] == f"fake {QUICK}" and found["ahead of"] == "fake quick noise=0.4"
    assert found["by"] == f"+{ahead:.2f} dB" and found["PSNR"].startswith(f"{sum(best) / 3:.2f} ±")
    # With two test views no difference is significant (p is at least 2 ^ (1 - n)), however large.
    assert found["how sure"].startswith(f"over 2 test views, 3 seeds; +{ahead:.2f}")
    assert "2 test views of one scene can't decide" in found["how sure"]
    single = next(cells for cells in glance.rows if cells[0][0].startswith("fern"))
    assert any("nothing to compare" in text or "one seed" in text for text, _ in single)


def test_what_was_run_on_what_and_how_long(made_report, reader: Reader) -> None:
    text = " ".join("".join(reader.texts).split())
    runs = len(list(made_report.results.rglob("result.json")))
    assert f"{runs} runs · 2 methods · 2 datasets" in text
    assert "fake quick trouble=lost on waves, seed 0: diverged: loss is nan at step 3" in text
    assert "4 training and 2 test views" in text and "trained on images with defocus" in text
    assert "JIT compilation" in text and "trained on all-in-focus images" in text
    (runs_table,) = [one for one in reader.tables if one.caption == "How each run was made"]
    assert len(runs_table.rows) == runs


def test_a_gap_has_its_reason_on_hover_and_as_a_note(made_report) -> None:
    reason = "the method has no lens to refocus with"
    for page in (made_report.page, made_report.pages["scores"]):
        found = re.search(rf'<a class="why" href="#(note-\d+)" title="{reason}">–', page)
        assert f'<li id="{found[1]}">{reason}</li>' in page


def test_time_and_frames_a_second(made_report, reader: Reader) -> None:
    (costs,) = [one for one in reader.tables if one.caption == "Training time and frame rate, sharp-inputs-v3: waves"]
    result = of(made_report, "fake", protocol="sharp-inputs-v3")
    here = "measured here, waves"
    assert costs.cell("fake", here, "training, CPU [s]") == f"{result.stages['train'].cpu:.1f}"
    assert costs.cell("fake", here, "imports and JIT [s]") == f"{result.scores['cold_start_s']:.1f}"
    assert costs.cell("fake", here, "peak memory [MB]") == f"{result.scores['peak_mb']:.0f}"
    assert costs.cell("DoF-Gaussian", "the paper's, on other data", "rendering [frames/s] ↑") == "364.0"


def test_the_papers_figures_stand_apart(reader: Reader) -> None:
    (scenes,) = [one for one in reader.tables if one.caption.endswith("learned lens: scene by scene")]
    theirs = "DoF-Gaussian the paper's, on other data"
    assert scenes.cell(theirs, "fern_small", "PSNR [dB] ↑") == "28.41"
    assert scenes.cell(theirs, "fern_small", "δ_F ↓") == "0.102"
    (ours_alone,) = [heading for group, heading in scenes.grouped if group == "fern_small" and heading[:3] == "δ_R"]
    assert scenes.cell(theirs, "fern_small", ours_alone).startswith("–")
    assert scenes.cell(theirs, "waves", "PSNR [dB] ↑").startswith("–")  # nor this scene
    (means,) = [one for one in reader.tables if one.caption.endswith("learned lens: mean over 2 scenes")]
    assert means.cell("DoF-NeRF", "the paper's, on other data", "PSNR [dB] ↑") == "25.59"
    theirs = "the paper's, on other data"
    assert means.cell("DoF-NeRF", theirs, "SSIM, uniform window 7 ↑") == "0.788"  # the digits that it prints
    own = next(row for row in means.grouped if row == ("measured here, mean over 2 scenes", "SSIM, uniform window 7 ↑"))
    assert means.cell(f"fake {QUICK} 2 of 2", *own).startswith("0.")  # their SSIM, measured here
    assert any("Gaussian one of 11" in text for text in reader.texts)
    assert means.cell("DoF-NeRF", "measured here, mean over 2 scenes", "PSNR [dB] ↑").startswith("–")


def test_the_papers_figures_stand_beside_the_method_as_it_is(boards: list, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not beside rows with options changed, which aren't what the paper measured."""
    monkeypatch.setattr(layouts, "_card_name", {"fake": "DoF-Gaussian", "pinhole": "Mip-Splatting"}.get)
    tables = read(shown(*layouts.layout_sections(boards))).tables
    means = next(one for one in tables if one.caption.endswith("learned lens: mean over 2 scenes"))
    theirs = "the paper's, on other data"
    assert means.cell(f"fake {QUICK} 2 of 2", theirs, "PSNR [dB] ↑") == "28.70"
    assert means.cell("fake quick noise=0.4", theirs, "PSNR [dB] ↑").startswith("–")
    assert not any(row[0][0] == "DoF-Gaussian" for row in means.rows)  # it has a row already


def test_the_papers_means_are_those_of_its_scenes() -> None:
    """The paper prints some numbers twice; a typing error in our copy of either would be noticed."""
    figures = paper_figures()
    assert set(figures) == {"main", "synthetic", "all_in_focus", "time"}
    theirs = figures["synthetic"].scenes
    llff = [theirs[scene] for scene in ("fern", "flower", "fortress", "horns", "orchids", "room", "trex")]
    for layout, scenes in (("synthetic", llff), ("all_in_focus", list(figures["all_in_focus"].scenes.values()))):
        for method, printed in figures[layout].means.items():
            for column, value in printed.items():
                mean = sum(scene[method][column] for scene in scenes) / len(scenes)
                if (layout, method, column) == ("all_in_focus", "DoF-Gaussian", "aif_psnr"):
                    assert (value, round(mean, 2)) == (27.81, 27.86)  # the paper disagrees with its supplement
                    continue
                assert mean == pytest.approx(value, abs=PRINTED_MEAN[column]), (layout, method, column)
    main = figures["main"].means["DoF-Gaussian"]  # Table 4, row #5, is the same method on the same scenes
    assert main["aif_psnr"] == pytest.approx(23.97, abs=PRINTED_MEAN["aif_psnr"])
    assert main["aif_ssim_uniform7"] == pytest.approx(0.756, abs=PRINTED_MEAN["aif_ssim_uniform7"])


def test_every_method_of_the_paper_has_a_card_of_that_name() -> None:
    """So that its figures stand in the row of the method that was run here."""
    cards = {find_method(file.parent.name).card.name for file in content_folder("methods").glob("*/method.toml")}
    printed = {
        method
        for figures in paper_figures().values()
        for rows in (figures.means, *figures.scenes.values())
        for method in rows
    }
    assert printed and printed <= cards


def test_a_method_without_any_score_of_a_table_is_told_below_it(boards: list, monkeypatch: pytest.MonkeyPatch) -> None:
    tables = read(shown(*layouts.layout_sections(boards))).tables
    for caption in ("learned lens: mean over 2 scenes", "learned lens: scene by scene"):
        (table,) = [one for one in tables if one.caption.endswith(caption)]
        assert not any("pinhole" in cell for row in table.rows for cell, _ in row)
    said = layouts.layout_sections(boards)[0].tables[0].below[0]
    assert said.startswith("No row, as they have none of these scores: ")
    assert "; pinhole quick (the method has no lens to refocus with)." in said
    # A failure has its row, and a method that the paper has figures of.
    (waves,) = [board for board in boards if board.name == "waves" and not board.sharp]
    (table,) = layouts.layout_sections([waves])[0].tables
    assert any("trouble=lost" in row[1].text and row[3].text == "diverged" for row in table.rows)
    monkeypatch.setattr(layouts, "_card_name", {"fake": "DoF-Gaussian", "pinhole": "DoF-NeRF"}.get)
    tables = read(shown(*layouts.layout_sections(boards))).tables
    (table,) = [one for one in tables if one.caption.endswith("learned lens: mean over 2 scenes")]
    assert any("pinhole" in cell for row in table.rows for cell, _ in row)


def test_a_failed_run_adds_no_table_of_what_its_dataset_is_not_for(boards: list) -> None:
    known = [board for board in boards if board.name == "waves" and not board.sharp]
    titles = {one.id: one.title for one in layouts.LAYOUTS}
    shown = {section.title.removesuffix(f", {known[0].kind}") for section in layouts.layout_sections(known)}
    assert {titles["synthetic"], titles["main"]} <= shown and not {titles["photographs"], titles["across"]} & shown


# ---- ablations ----


ABLATION, BOARD = ("ablation", "noise.md"), ("out", "leaderboard.md")


@pytest.mark.parametrize(
    ("file", "heading", "caption"),
    [
        (ABLATION, "waves", "What noise costs: waves"),
        (ABLATION, "Difference from some", "What noise costs: Difference from some"),
        (BOARD, "waves, refocus-v3", "waves, refocus-v3"),
        (BOARD, "Compared view by view", "Compared view by view: fern_small, refocus-v3"),
        (BOARD, "Published by the authors, on their own data", "Published by the authors, on their own data"),
        (BOARD, "How these were made", "How each run was made"),
    ],
)
def test_the_page_and_the_markdown_say_the_same(
    made_report, reader: Reader, file: tuple[str, str], heading: str, caption: str
) -> None:
    """Every cell of a table in Markdown stands in the page's, with its spread and its verdict."""
    rows = table_rows((getattr(made_report, file[0]) / file[1]).read_text(), heading)
    (shown,) = [one for one in reader.tables if one.caption == caption]
    assert len(rows) == len(shown.rows) > 0
    for row, cells in zip(rows, shown.rows, strict=True):
        # Markdown has columns that no row fills, and the page some that Markdown has no room for.
        texts = [(column.strip("*").removeprefix("paper: "), text) for column, text in row.items()]
        said = [(column, markdown_words(text)) for column, text in texts if column in shown.headings]
        there = [(column, shown_words(*cell)) for column, cell in zip(shown.headings, cells, strict=True)]
        names = {column for column, _ in said}
        assert [one for one in there if one[0] in names] == said and len(said) > 2


def markdown_words(text: str) -> str:
    """A cell without the marks of a footnote and of the best, and without commas."""
    return re.sub(r"\[\^\d+\]|[\s*,`]", "", text)


def shown_words(text: str, kind: str) -> str:
    """The same of a cell of the page, where a footnote's mark is a number behind a gap or a failure."""
    noted = "gap" in kind or "failure" in kind
    return markdown_words(re.sub(r"\d+$", "", text) if noted else text.removesuffix(", best"))


def test_a_difference_of_an_ablation_has_the_verdict_of_its_records(made_report, reader: Reader) -> None:
    (shown,) = [one for one in reader.tables if one.caption == "What noise costs: Difference from some"]
    cell = shown.cell("more", "", "PSNR [dB] ↑")
    with (made_report.ablation / "noise-summary.csv").open() as stream:
        (record,) = [
            row
            for row in csv.DictReader(stream)
            if (row["row"], row["dataset"], row["column"]) == ("more", "mean", "psnr")
        ]
    # Of seven views that all say the same, two of 2 ** 7 choices of signs are as far out.
    assert record["verdict"] == "worse" and cell.startswith(f"{float(record['difference']):+.2f} [")
    assert cell.endswith(f"p = {float(record['p']):.3f}, worse")
    assert f'title="± {float(record["difference_sd"]):.2f} over 7 differences"' in made_report.page
    assert "view by view over all datasets" in made_report.page


def test_what_is_no_table_of_ablations_is_one_line(made_report, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no \\*.json"):
        read_documents(tmp_path)
    whole = json.loads((made_report.ablation / "noise.json").read_text())
    for change, problem in (
        ({"schema_name": "other"}, "something else"),
        ({"version": 3}, "version 3, expected version 2"),
        ({"document": {**whole["document"], "text": 1}}, "text"),
        ({"document": {"id": "noise"}}, "title"),
        ({"version": 1, "document": {"id": "noise", "blocks": [{"type": "paragraph"}]}}, "title"),
    ):
        (tmp_path / "a.json").write_text(json.dumps({**whole, **change}))
        with pytest.raises(InputError, match=problem) as wrong:
            read_documents(tmp_path)
        assert "\n" not in str(wrong.value) and "a.json" in str(wrong.value)
    (tmp_path / "a.json").write_text(json.dumps(whole))
    assert read_documents(tmp_path) == read_documents(made_report.ablation)


def test_a_table_of_ablations_of_an_older_version_is_read(made_report, tmp_path: Path) -> None:
    def older(section: dict) -> list[dict]:
        blocks = [{"type": "paragraph", "text": text} for text in section["text"]]
        blocks += [{"type": "table", **table} for table in section["tables"]]
        blocks += [{"type": "command", "text": section["command"]}] if section["command"] else []
        blocks += [{"type": "items", "items": section["items"]}] if section["items"] else []
        return blocks + [
            {"type": "section", "title": one["title"], "blocks": older(one)} for one in section["sections"]
        ]

    whole = json.loads((made_report.ablation / "noise.json").read_text())
    page = whole["document"]
    document = {"id": page["id"], "title": page["title"], "blocks": older(page)}
    (tmp_path / "a.json").write_text(json.dumps({**whole, "version": 1, "document": document}))
    assert read_documents(tmp_path) == read_documents(made_report.ablation)


# ---- pictures ----


@pytest.fixture
def boards(made_report) -> list:
    return gather(collect(made_report.results).entries)


def parts(page: str, kind: str) -> dict[str, str]:
    """Title -> HTML of each part of the page of a kind: board, view, kind."""
    found = re.split(rf'<(?:div|details) class="{kind}" data-title="([^"]*)"', page)
    return dict(zip(map(unescape, found[1::2]), found[2::2], strict=True))


def test_every_view_kind_and_method_has_its_pictures(made_report) -> None:
    boards = parts(made_report.page, "board")
    assert set(boards) == {"waves, refocus-v3", "waves, sharp-inputs-v3", "fern_small, refocus-v3"}
    views = parts(boards["fern_small, refocus-v3"], "view")
    assert [name.partition(" ")[0] for name in views] == ["v0", "v1", "v2"]
    kinds = parts(views["v0 (F 0.2, A 0.5)"], "kind")
    refocused, sharp = kinds["through the view's own lens"], kinds["all in focus"]
    of_fake = ["picture", "error"]
    assert re.findall(r'<img class="(\w+)"', refocused) == ["picture", *of_fake]  # the reference first
    assert "No picture of pinhole quick, seed 0: the method has no lens to refocus with." in refocused
    scores = of(made_report, "fake", dataset="fern_small").views[0].scores
    assert f"PSNR ↑ {scores['psnr']:.2f}" in refocused
    # The resolved map stands next to what it explains.
    assert re.findall(r'<img class="(\w+)"', sharp)[:4] == ["picture", *of_fake, "resolved"]


def test_pictures_come_first(made_report) -> None:
    assert made_report.page.index("<img") < made_report.page.index("<table")


def test_pictures_are_the_files_that_were_scored(made_report) -> None:
    (run,) = [
        folder
        for file in made_report.results.rglob("result.json")
        if (folder := file.parent).parent.name == "fern_small" and folder.name.startswith("fake")
    ]
    view = parts(parts(made_report.page, "board")["fern_small, refocus-v3"], "view")["v0 (F 0.2, A 0.5)"]
    shown = [made_report.out / name for name in re.findall(r'src="([^"]+)"', view)]
    kept = {path.read_bytes() for path in (run / "predictions").rglob("v0.png")}
    assert kept and kept <= {path.read_bytes() for path in shown}


def test_rows_that_only_the_paper_has_can_be_folded(made_report) -> None:
    rows = re.findall(r"<tr class=\"theirs\">(.*?)</tr>", made_report.page)
    assert rows and all("the paper" in row for row in rows)
    others = re.findall(r"<tr>(.*?)</tr>", made_report.page)
    assert not any("paper&#39;s only" in row for row in others)


# ---- parts ----


def test_sorting_keys_are_numbers_or_absent() -> None:
    cells = (number(1.5, "1.50"), number(math.nan, "nan"), number(math.inf, "inf"), Cell("none"))
    html = shown(Section("", tables=(Table("t", tuple(map(Heading, "abcd")), (cells,), names=0),)))
    assert re.findall(r"<td[^>]*>", html) == [
        '<td class="number" data-sort="1.5">',
        '<td class="number">',
        '<td class="number" data-sort="Infinity">',
        '<td class="words">',
    ]
