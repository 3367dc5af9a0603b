"""The report's pages in a browser: no console output, no requests, and working controls."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Page, browser
from tolerances import DRAWN_PIXEL

from dofbench.core.images import read_image, to_8bit
from dofbench.evaluation.results.result import read_result


@pytest.fixture(scope="module")
def chromium() -> Iterator[Page]:
    """A page of a desktop's size."""
    with browser() as page:
        page.size(1280, 900)
        yield page


def fixture_of(name: str, ready: str) -> Any:
    """A fixture that opens a page of the report from its file, if it isn't open, and waits until it is ready."""

    @pytest.fixture(name=name)
    def opened(chromium: Page, made_report) -> Page:
        file = made_report.out / f"{name}.html"
        if chromium.run("location.href") != file.resolve().as_uri():
            chromium.open(file)
            chromium.wait(ready)
        return chromium

    return opened


first = fixture_of("report", "document.querySelector('.kind.shown img.picture')?.naturalWidth > 0")
second = fixture_of("curves", "document.querySelector('#chart svg') !== null")
third = fixture_of("scores", "true")


def middle(page: Page, node: str) -> tuple[float, float]:
    """Where a node is, after it was brought into sight."""
    page.run(f"{node}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
    return tuple(
        page.run(
            f"(({{left, top, width, height}}) => [left + width / 2, top + height / 2])({node}.getBoundingClientRect())"
        )
    )


def click(page: Page, node: str) -> None:
    x, y = middle(page, node)
    for kind in ("moved", "pressed", "released"):
        page.mouse(kind, x, y)


def choose(page: Page, select: str, text: str) -> None:
    """Choose an option as a person does: the page is told that it changed."""
    assert page.run(
        f"(() => {{ const node = document.getElementById({select!r});"
        f"const index = [...node.options].findIndex((option) => option.textContent === {text!r});"
        "if (index < 0) return false; node.selectedIndex = index;"
        "node.dispatchEvent(new Event('change')); return true; })()"
    ), text


# ---- no console output, no requests ----


def test_nothing_but_the_reports_own_files_is_asked_for(report: Page, made_report) -> None:
    asked = [url for url in report.requests if not url.startswith(("data:", "about:"))]
    own = {file.resolve().as_uri() for file in made_report.out.rglob("*") if file.is_file()}
    assert asked and set(asked) <= own
    assert report.errors == []


def test_a_request_would_be_refused(made_report, tmp_path: Path) -> None:
    """Even a script that got in could fetch nothing: the page's own policy forbids it."""
    file = tmp_path / "policy.html"
    (tmp_path / "other.txt").write_text("other")
    script = "<script>fetch('other.txt').catch(() => { document.title = 'refused'; })</script>"
    file.write_text(made_report.page.replace("</body>", f"{script}</body>"))
    with browser() as page:
        page.open(file)
        page.wait("document.title === 'refused'")
        assert any("Content Security Policy" in error for error in page.errors)


def test_without_scripts_there_are_pictures_and_tables(made_report) -> None:
    with browser() as page:
        page.size(1280, 900)
        page.call("Emulation.setScriptExecutionDisabled", value=True)
        page.open(made_report.out / "report.html")
        seen = "(selector) => [...document.querySelectorAll(selector)].filter((node) => node.offsetHeight > 9).length"
        page.wait("[...document.querySelectorAll('.kind img.picture')].some((image) => image.naturalWidth > 0)")
        kinds = 4  # of the first view of each board: two of the two with defocus, one without
        assert page.run(f"({seen})('.kind .places')") >= kinds and page.run(f"({seen})('table')") > 3
        assert page.run(f"({seen})('.bar button, .bar select, .copy')") == 0
        page.run("document.getElementById('layer-error').click()")  # a radio button, which needs no script
        assert page.run(f"({seen})('.kind img.error')") > 0
        assert page.errors == []


# ---- tables ----

BOARD = "[...document.querySelectorAll('table')].find((t) => t.caption?.textContent === 'waves, refocus-v3')"


def column(page: Page, heading: str) -> tuple[str, list[str | None]]:
    """(aria-sort, sorting keys in the rows' order) of a column."""
    return tuple(
        page.run(
            f"(() => {{ const table = {BOARD}; const cells = [...table.tHead.rows].at(-1).cells;"
            f"const index = [...cells].findIndex((cell) => cell.textContent.startsWith({heading!r}));"
            "return [cells[index].getAttribute('aria-sort'),"
            "[...table.tBodies[0].rows].map((row) => sortKey(row.cells[index]))]; })()"
        )
    )


def button(heading: str) -> str:
    return f"[...{BOARD}.querySelectorAll('th button')].find((b) => b.textContent.startsWith({heading!r}))"


def ordered(keys: list[str | None], *, down: bool) -> bool:
    """Whether numbers are in order, and cells without a number are last."""
    numbers = [float(key) for key in keys if key is not None]
    return keys[len(numbers) :] == [None] * (len(keys) - len(numbers)) and numbers == sorted(numbers, reverse=down)


def test_tables_sort_by_click_and_by_key(scores: Page) -> None:
    assert column(scores, "FLIP")[0] is None
    click(scores, button("FLIP"))  # an error: the least comes first
    order, keys = column(scores, "FLIP")
    assert order == "ascending" and ordered(keys, down=False) and keys.count(None) > 1
    click(scores, button("FLIP"))
    order, keys = column(scores, "FLIP")
    assert order == "descending" and ordered(keys, down=True) and keys[-1] is None and keys[0] is not None
    scores.run(f"{button('PSNR')}.focus()")
    scores.key("Enter")
    order, keys = column(scores, "PSNR")
    assert order == "descending" and ordered(keys, down=True)  # the largest is the best
    assert "PSNR" in scores.run("document.getElementById('said').textContent")
    click(scores, button("method"))
    assert column(scores, "FLIP")[0] is None  # only one column says that it is sorted
    assert column(scores, "method") == ("ascending", sorted(column(scores, "method")[1]))


def test_the_reason_of_a_gap_shows_on_hover_and_on_focus(scores: Page) -> None:
    link = f"[...{BOARD}.querySelectorAll('.why')].find((a) => a.ariaLabel.includes('no lens to refocus'))"
    x, y = middle(scores, link)
    scores.mouse("moved", 1, 1)
    assert scores.run("document.getElementById('tip').hidden")
    scores.mouse("moved", x, y)
    assert scores.run("document.getElementById('tip').textContent") == "the method has no lens to refocus with"
    assert not scores.run("document.getElementById('tip').hidden")
    scores.mouse("moved", 1, 1)
    assert scores.run("document.getElementById('tip').hidden")
    scores.run(f"{link}.focus()")
    assert not scores.run("document.getElementById('tip').hidden")
    scores.run("document.activeElement.blur()")


def copied(page: Page, table: str, form: str) -> str:
    """What a click on a table's button puts into the clipboard."""
    page.run("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    click(page, f"[...{table}.closest('.scroll').previousElementSibling.querySelectorAll('.copy button')]"
          f".find((b) => b.textContent === {form!r})")  # fmt: skip
    page.wait("window.copied !== undefined")
    return str(page.run("(() => { const text = window.copied; delete window.copied; return text; })()"))


def test_a_table_is_copied_as_csv_latex_and_markdown(scores: Page) -> None:
    shown = scores.run(
        f"[...{BOARD}.tBodies[0].rows].map((row) => [...row.cells].map((cell) => [cell.className, cell.textContent]))"
    )
    headings = scores.run(f"[...[...{BOARD}.tHead.rows].at(-1).cells].map((cell) => cell.textContent.trim())")
    psnr = headings.index("PSNR [dB] ↑")
    lines = list(csv.DictReader(io.StringIO(copied(scores, BOARD, "CSV"))))
    assert len(lines) == len(shown)
    for line, cells in zip(lines, shown, strict=True):
        kind, text = cells[psnr]
        text = re.sub(r"\d+$", "", text) if "failure" in kind else text  # without the mark of its note
        value, _, spread = text.removesuffix(", best").partition(" ± ")
        assert (line["PSNR [dB] ↑"], line["PSNR [dB] ↑ ±"]) == (("", "") if "gap" in kind else (value, spread))
    best = next(cells[psnr][1].removesuffix(", best") for cells in shown if "best" in cells[psnr][0])
    tex = copied(scores, BOARD, "LaTeX")
    strong = best.replace("±", "$\\pm$")
    assert f"\\textbf{{{strong}}}" in tex and "PSNR [dB] $\\uparrow$" in tex
    body = tex.split("\\midrule\n")[1].split("\\bottomrule")[0].strip().splitlines()
    assert {line.count(" & ") for line in body} == {len(headings) - 1} and len(body) == len(shown)
    assert tex.count("\\begin{tabular}") == 1 and "δ" not in tex and "–" not in tex
    marked = copied(scores, BOARD, "Markdown").splitlines()
    assert len(marked) == len(shown) + 2 and f"| **{best}** |" in "".join(marked)
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in marked}) == 1


def test_where_the_clipboard_is_refused_a_file_is_saved(scores: Page) -> None:
    scores.run(
        "navigator.clipboard.writeText = async () => { throw new Error('refused'); };"
        "HTMLAnchorElement.prototype.click = function () { window.saved = this.download; };"
    )
    click(scores, f"{BOARD}.closest('.scroll').previousElementSibling.querySelector('.copy button')")
    scores.wait("window.saved !== undefined")
    assert scores.run("window.saved") == "waves_refocus-v3.csv"


def test_rows_that_only_the_paper_has_are_folded_until_asked_for(report: Page) -> None:
    table = "document.querySelector('tr.theirs').closest('table')"
    seen = f"[...{table}.querySelectorAll('tbody tr')].map((row) => [row.className, row.offsetHeight > 0])"
    box = f"{table}.closest('.scroll').previousElementSibling.querySelector('.fold')"
    assert all(shown is (kind == "") for kind, shown in report.run(seen))
    folded = len(copied(report, table, "CSV").splitlines())
    click(report, box)
    rows = report.run(seen)
    assert all(shown for _, shown in rows)
    theirs = sum(kind == "theirs" for kind, _ in rows)
    assert len(copied(report, table, "CSV").splitlines()) == folded + theirs and theirs > 0
    click(report, box)


# ---- curves ----


def test_every_pair_of_score_and_scene_can_be_chosen(curves: Page) -> None:
    pairs = set()
    for board in curves.run("[...document.getElementById('plot-board').options].map((o) => o.textContent)"):
        choose(curves, "plot-board", board)
        for score in curves.run("[...document.getElementById('plot-score').options].map((o) => o.textContent)"):
            choose(curves, "plot-score", score)
            assert curves.run("document.querySelectorAll('#chart path').length") > 2
            shown = curves.run(
                "[...document.querySelectorAll('.plot-tables')].filter((t) => t.offsetHeight)"
                ".map((t) => t.querySelector('h4').textContent)"
            )
            assert shown == [f"{score} on {board}"]
            pairs.add((board, score))
    assert {
        ("waves, refocus-v3", "PSNR"),
        ("waves, refocus-v3", "δ_F"),
        ("fern_small, refocus-v3", "δ_A"),
        ("waves, sharp-inputs-v3", "all-in-focus SSIM"),
    } <= pairs
    choose(curves, "plot-board", "waves, refocus-v3")


def test_curves_show_values_on_hover(curves: Page, made_report) -> None:
    choose(curves, "plot-board", "fern_small, refocus-v3")
    choose(curves, "plot-score", "PSNR")  # which the pinhole has not: there is one curve
    (fake,) = [
        one
        for path in made_report.results.rglob("result.json")
        if (one := read_result(path)).spec.method == "fake" and one.spec.dataset == "fern_small"
    ]
    last = fake.curve[-1]
    # The last path is the curve's last mark.
    x, y = middle(curves, "document.querySelector('#chart svg')")
    x, y = curves.run(
        "(({left, top, width, height}) => [left + width / 2, top + height / 2])"
        "([...document.querySelectorAll('#chart svg > path')].at(-1).getBoundingClientRect())"
    )
    curves.mouse("moved", x, y)
    said = curves.run("document.getElementById('tip').textContent")
    assert said.startswith("fake quick, seed 0")
    assert f"PSNR {last.scores['psnr']:.2f} dB after {last.train_s:.1f} s" in said
    curves.mouse("moved", 1, 1)
    assert curves.run("document.getElementById('tip').hidden")


def test_curves_can_be_walked_by_arrow_keys(curves: Page) -> None:
    choose(curves, "plot-board", "waves, refocus-v3")
    choose(curves, "plot-score", "PSNR")
    curves.run("document.querySelector('#chart svg').focus()")
    heard = []
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "ArrowLeft"):
        curves.key(key)
        heard.append(curves.run("document.getElementById('said').textContent"))
    assert all(" dB after " in said for said in heard) and len(set(heard)) == len(heard)
    assert heard[1].partition(":")[0] != heard[2].partition(":")[0]  # down goes to another curve


def test_a_curve_can_be_switched_off(curves: Page) -> None:
    before = curves.run("document.querySelectorAll('#chart svg > path').length")
    click(curves, "document.querySelector('#plot-legend button')")
    assert curves.run("document.querySelector('#plot-legend button').ariaPressed") == "false"
    assert curves.run("document.querySelectorAll('#chart svg > path').length") < before
    click(curves, "document.querySelector('#plot-legend button')")
    assert curves.run("document.querySelectorAll('#chart svg > path').length") == before


def test_time_is_on_a_log_axis(curves: Page) -> None:
    """Equal ratios of time are equal distances: by the marks of one run, whose times are in the data."""
    choose(curves, "plot-board", "fern_small, refocus-v3")
    choose(curves, "plot-score", "PSNR")
    run = next(
        one
        for one in json.loads(curves.run("document.getElementById('data').textContent"))["plots"]
        if (one["board"], one["column"]) == ("fern_small, refocus-v3", "psnr")
    )["series"][0]["runs"][0]["points"]
    drawn = curves.run("document.querySelector('#chart svg > path[stroke]').getAttribute('d')")
    xs = [float(point.split(",")[0]) for point in drawn[1:].split("L")]
    assert len(xs) == len(run) > 3
    ratios = [(x - xs[0]) / math.log(time / run[0][0]) for x, (time, _) in zip(xs[1:], run[1:], strict=True)]
    assert max(ratios) == pytest.approx(min(ratios), rel=DRAWN_PIXEL)


# ---- pictures ----


def pixels(page: Page, node: str, tmp_path: Path) -> np.ndarray:
    """(H, W, 3) uint8: what a node shows, after it was brought into sight."""
    middle(page, node)
    left, top, width, height = page.run(
        f"(({{left, top, width, height}}) => [left, top, width, height].map(Math.round))"
        f"({node}.getBoundingClientRect())"
    )
    page.picture(tmp_path / "shot.png")
    return to_8bit(read_image(tmp_path / "shot.png"))[top : top + height, left : left + width]


def press(page: Page, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        page.call(
            "Input.dispatchKeyEvent",
            type=kind,
            key=key,
            **({"text": key} if kind == "keyDown" and len(key) == 1 else {}),
        )


def wheel(page: Page, node: str, turns: int) -> None:
    """Turn the wheel over a node's middle; positive turns zoom in."""
    x, y = middle(page, node)
    for _ in range(abs(turns)):
        page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-100 if turns > 0 else 100)
    page.run("new Promise(requestAnimationFrame)")


def pane(number: int) -> str:
    return f"document.querySelectorAll('.kind.shown .pane')[{number}]"


ZOOM = "document.getElementById('zoom').textContent"


@pytest.fixture
def at_fit(report: Page) -> Page:
    """The first page with the pictures of one view with defocus, at fit."""
    choose(report, "picture-board", "fern_small, refocus-v3")
    choose(report, "picture-kind", "all in focus")
    for _ in range(9):
        click(report, "document.getElementById('zoom-out')")
    if report.run("document.getElementById('wipe').ariaPressed") == "true":
        press(report, "w")
    report.run("document.getElementById('layer-picture').click(); document.activeElement.blur()")
    report.wait("[...document.querySelectorAll('.kind.shown img')].every((image) => image.naturalWidth === 64)")
    return report


def test_every_view_and_kind_can_be_chosen(at_fit: Page) -> None:
    for board, views in (("waves, refocus-v3", 2), ("fern_small, refocus-v3", 3)):
        choose(at_fit, "picture-board", board)
        names = at_fit.run("[...document.getElementById('picture-view').options].map((o) => o.textContent)")
        assert len(names) == views
        for name in names:
            choose(at_fit, "picture-view", name)
            for kind in ("through the view's own lens", "all in focus"):
                choose(at_fit, "picture-kind", kind)
                shown = at_fit.run(
                    "[...document.querySelectorAll('.kind')].filter((k) => k.offsetHeight)"
                    ".map((k) => [k.dataset.title, k.closest('.view').dataset.title])"
                )
                assert shown == [[kind, name]]


def test_the_wheel_zooms_all_pictures_at_whole_pixels(at_fit: Page, made_report, tmp_path: Path) -> None:
    """Each pixel of the file is a block of equal pixels on the screen, and every picture shows the same crop."""
    click(at_fit, pane(1))
    wheel(at_fit, pane(1), 5)
    assert at_fit.run(ZOOM) == "6×"
    crops = []
    for number in (0, 1):
        shown = pixels(at_fit, pane(number), tmp_path)
        name = at_fit.run(f"{pane(number)}.querySelector('img').getAttribute('src')")
        source = to_8bit(read_image(made_report.out / name))
        # The block at the middle of the pane, whose corner is where the picture's lengths say.
        left, top = at_fit.run(
            f"(() => {{ const style = {pane(number)}.parentElement.parentElement.style;"
            "return ['--left', '--top'].map((name) => parseFloat(style.getPropertyValue(name))); })()"
        )
        assert (left, top) == (round(left), round(top)) and left < 0
        across, down = (round((shown.shape[axis] / 2 - at) // 6) for axis, at in ((1, left), (0, top)))
        for dx, dy in ((0, 0), (3, 2), (-4, -3)):
            x, y = int(left) + 6 * (across + dx), int(top) + 6 * (down + dy)
            block = shown[y : y + 6, x : x + 6]
            assert (block == source[down + dy, across + dx]).all()
        crops.append((left, top))
    assert crops[0] == crops[1]


def test_a_wheel_over_a_picture_that_was_not_clicked_scrolls(at_fit: Page) -> None:
    wheel(at_fit, pane(0), -1)
    assert at_fit.run(ZOOM) == "fit"


def test_a_drag_and_arrow_keys_move_every_picture(at_fit: Page) -> None:
    click(at_fit, pane(0))
    press(at_fit, "+")
    for _ in range(5):
        press(at_fit, "+")
    place = "[...document.querySelectorAll('.kind.shown .pane img.picture')].map((i) => i.offsetLeft)"
    before = at_fit.run(place)
    x, y = middle(at_fit, pane(0))
    at_fit.mouse("pressed", x, y)
    at_fit.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + 30, y=y, button="left", buttons=1)
    at_fit.mouse("released", x + 30, y)
    assert at_fit.run(place) == [one + 30 for one in before]
    press(at_fit, "ArrowRight")
    assert at_fit.run(place) == [one - 10 for one in before]
    press(at_fit, "0")
    assert at_fit.run(ZOOM) == "fit"


def test_a_key_switches_error_maps_on_and_off(at_fit: Page, made_report, tmp_path: Path) -> None:
    click(at_fit, pane(1))
    for _ in range(5):  # so far that the picture fills its place
        press(at_fit, "+")
    before = pixels(at_fit, pane(1), tmp_path)
    reference = pixels(at_fit, pane(0), tmp_path)
    press(at_fit, "e")
    errors = pixels(at_fit, pane(1), tmp_path)
    assert (errors != before).any() and (pixels(at_fit, pane(0), tmp_path) == reference).all()
    source = to_8bit(read_image(made_report.out / at_fit.run(f"{pane(1)}.querySelector('.error').getAttribute('src')")))
    inside = {tuple(colour) for colour in errors[20:-20, 20:-20].reshape(-1, 3)}
    assert inside <= {tuple(colour) for colour in source.reshape(-1, 3)}
    press(at_fit, "e")
    assert (pixels(at_fit, pane(1), tmp_path) == before).all()
    press(at_fit, "r")
    assert at_fit.run("document.querySelector('.of-resolved').offsetHeight") > 0


def test_the_wipe_moves_by_key_and_by_mouse(at_fit: Page) -> None:
    press(at_fit, "w")
    split = "document.getElementById('compare').style.getPropertyValue('--split')"
    at_fit.run("document.querySelector('#compare input').focus()")
    start = float(at_fit.run(split).strip().rstrip("%"))
    at_fit.key("ArrowRight")
    assert float(at_fit.run(split).rstrip("%")) == start + 1
    _, y = middle(at_fit, "document.getElementById('compare')")
    left, width = at_fit.run(
        "(({left, width}) => [left, width])(document.getElementById('compare').getBoundingClientRect())"
    )
    for kind in ("moved", "pressed", "released"):
        at_fit.mouse(kind, left + 0.2 * width, y)
    assert 15 <= float(at_fit.run(split).rstrip("%")) <= 25
    bar = at_fit.run("document.querySelector('#compare .line').getBoundingClientRect().left")
    assert 0.15 < (bar - left) / width < 0.25
    names = at_fit.run("[...document.getElementById('picture-right').options].map((o) => o.textContent)")
    assert names[0] == "reference" and "resolved, fake quick, seed 0" in names
    choose(at_fit, "picture-right", "error of fake quick, seed 0")
    assert at_fit.run("document.querySelector('#compare img.right').alt").startswith("error of fake")
    assert at_fit.run("document.querySelector('.scale').offsetHeight") > 0


def test_the_refocus_slider_changes_every_frame(at_fit: Page) -> None:
    part = "document.querySelector('.moving.shown .refocus')"
    shown = f"[...{part}.querySelectorAll('img')].map((i) => i.offsetHeight > 0)"
    middle(at_fit, part)
    before = at_fit.run(shown)
    at_fit.run(f"{part}.querySelector('input').focus()")
    at_fit.key("ArrowRight")
    after = at_fit.run(shown)
    assert before.count(True) == 1 and after == [False, *before[:-1]]
    at_fit.wait(f"[...{part}.querySelectorAll('img')].every((image) => image.naturalWidth === 64)")


def test_a_film_is_there_to_be_played(at_fit: Page) -> None:
    pytest.importorskip("av", reason="no package av: pip install dofbench[film]")
    if not at_fit.run("document.createElement('video').canPlayType('video/mp4; codecs=\"avc1.42E01E\"')"):
        pytest.skip("this Chromium plays no H.264")
    choose(at_fit, "picture-board", "waves, sharp-inputs-v3")
    film = "document.querySelector('.moving.shown video')"
    middle(at_fit, film)
    at_fit.wait(f"{film}.readyState >= 1")
    assert at_fit.run(f"[{film}.videoWidth, {film}.videoHeight]") == [64, 48]


# ---- any screen ----


@pytest.mark.parametrize(("width", "phone"), [(1280, False), (360, True)])
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_sticks_out_at_the_side(chromium: Page, made_report, width: int, phone: bool, dark: bool) -> None:
    chromium.size(width, 800, dark=dark, phone=phone)
    try:
        for name in made_report.pages:
            chromium.open(made_report.out / f"{name}.html")
            assert chromium.run("[innerWidth, document.documentElement.scrollWidth]") == [width, width], name
            light = chromium.run("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)[0]")
            assert (light < 60) is dark
    finally:
        chromium.size(1280, 900)


def test_all_of_that_was_silent(chromium: Page) -> None:
    assert chromium.errors == []
    assert all(url.startswith(("data:", "about:", "file:")) for url in chromium.requests)
