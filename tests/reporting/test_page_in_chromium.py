"""report.html in a browser: no console output, no requests, and working controls."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium import Page, browser
from tolerances import DRAWN_PIXEL

from dofbench.evaluation.results.result import read_result


@pytest.fixture(scope="module")
def opened(made_report) -> Iterator[Page]:
    """The page, from a file, in a window of a desktop's size."""
    with browser() as page:
        page.size(1280, 900)
        page.open(made_report.out / "report.html")
        page.wait("document.querySelector('#chart svg') !== null")
        yield page


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


def test_no_error_and_no_request(opened: Page, made_report) -> None:
    asked = [url for url in opened.requests if not url.startswith("data:")]
    assert asked == [(made_report.out / "report.html").resolve().as_uri()]
    assert opened.errors == []


def test_a_request_would_be_refused(opened: Page, made_report, tmp_path: Path) -> None:
    """Even a script that got in could fetch nothing: the page's own policy forbids it."""
    file = tmp_path / "policy.html"
    (tmp_path / "other.txt").write_text("other")
    script = "<script>fetch('other.txt').catch(() => { document.title = 'refused'; })</script>"
    file.write_text(made_report.page.replace("</body>", f"{script}</body>"))
    with browser() as page:
        page.open(file)
        page.wait("document.title === 'refused'")
        assert any("Content Security Policy" in error for error in page.errors)


# ---- tables ----

BOARD = "[...document.querySelectorAll('table')].find((t) => t.caption?.textContent === 'waves, refocus-v3')"


def column(page: Page, heading: str) -> tuple[str, list[str | None]]:
    """(aria-sort, sorting keys in the rows' order) of a column."""
    return tuple(
        page.run(
            f"(() => {{ const table = {BOARD}; const cells = [...table.tHead.rows].at(-1).cells;"
            f"const index = [...cells].findIndex((cell) => cell.textContent.startsWith({heading!r}));"
            "return [cells[index].getAttribute('aria-sort'),"
            "[...table.tBodies[0].rows].map((row) => row.cells[index].dataset.sort ?? null)]; })()"
        )
    )


def button(heading: str) -> str:
    return f"[...{BOARD}.querySelectorAll('th button')].find((b) => b.textContent.startsWith({heading!r}))"


def ordered(keys: list[str | None], *, down: bool) -> bool:
    """Whether numbers are in order, and cells without a number are last."""
    numbers = [float(key) for key in keys if key is not None]
    return keys[len(numbers) :] == [None] * (len(keys) - len(numbers)) and numbers == sorted(numbers, reverse=down)


def test_tables_sort_by_click_and_by_key(opened: Page) -> None:
    assert column(opened, "FLIP")[0] is None
    click(opened, button("FLIP"))  # an error: the least comes first
    order, keys = column(opened, "FLIP")
    assert order == "ascending" and ordered(keys, down=False) and keys.count(None) > 1
    click(opened, button("FLIP"))
    order, keys = column(opened, "FLIP")
    assert order == "descending" and ordered(keys, down=True) and keys[-1] is None and keys[0] is not None
    opened.run(f"{button('PSNR')}.focus()")
    opened.key("Enter")
    order, keys = column(opened, "PSNR")
    assert order == "descending" and ordered(keys, down=True)  # the largest is the best
    assert "PSNR" in opened.run("document.getElementById('said').textContent")
    click(opened, button("method"))
    assert column(opened, "FLIP")[0] is None  # only one column says that it is sorted
    assert column(opened, "method") == ("ascending", sorted(column(opened, "method")[1]))


def test_the_reason_of_a_gap_shows_on_hover_and_on_focus(opened: Page) -> None:
    link = f"[...{BOARD}.querySelectorAll('.why')].find((a) => a.ariaLabel.includes('no lens to refocus'))"
    x, y = middle(opened, link)
    opened.mouse("moved", 1, 1)
    assert opened.run("document.getElementById('tip').hidden")
    opened.mouse("moved", x, y)
    assert opened.run("document.getElementById('tip').textContent") == "the method has no lens to refocus with"
    assert not opened.run("document.getElementById('tip').hidden")
    opened.mouse("moved", 1, 1)
    assert opened.run("document.getElementById('tip').hidden")
    opened.run(f"{link}.focus()")
    assert not opened.run("document.getElementById('tip').hidden")
    opened.run("document.activeElement.blur()")


# ---- curves ----


def test_every_pair_of_score_and_scene_can_be_chosen(opened: Page) -> None:
    pairs = set()
    for board in opened.run("[...document.getElementById('plot-board').options].map((o) => o.textContent)"):
        choose(opened, "plot-board", board)
        for score in opened.run("[...document.getElementById('plot-score').options].map((o) => o.textContent)"):
            choose(opened, "plot-score", score)
            assert opened.run("document.querySelectorAll('#chart path').length") > 2
            shown = opened.run(
                "[...document.querySelectorAll('.plot-tables')].filter((t) => !t.hidden)"
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
    choose(opened, "plot-board", "waves, refocus-v3")


def test_curves_show_values_on_hover(opened: Page, made_report) -> None:
    choose(opened, "plot-board", "fern_small, refocus-v3")
    choose(opened, "plot-score", "PSNR")  # which the pinhole has not: there is one curve
    (fake,) = [
        one
        for path in made_report.results.rglob("result.json")
        if (one := read_result(path)).spec.method == "fake" and one.spec.dataset == "fern_small"
    ]
    last = fake.curve[-1]
    # The last path is the curve's last mark.
    x, y = middle(opened, "document.querySelector('#chart svg')")
    x, y = opened.run(
        "(({left, top, width, height}) => [left + width / 2, top + height / 2])"
        "([...document.querySelectorAll('#chart svg > path')].at(-1).getBoundingClientRect())"
    )
    opened.mouse("moved", x, y)
    said = opened.run("document.getElementById('tip').textContent")
    assert said.startswith("fake quick, seed 0")
    assert f"PSNR {last.scores['psnr']:.2f} dB after {last.train_s:.1f} s" in said
    opened.mouse("moved", 1, 1)
    assert opened.run("document.getElementById('tip').hidden")


def test_curves_can_be_walked_by_arrow_keys(opened: Page) -> None:
    choose(opened, "plot-board", "waves, refocus-v3")
    choose(opened, "plot-score", "PSNR")
    opened.run("document.querySelector('#chart svg').focus()")
    heard = []
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "ArrowLeft"):
        opened.key(key)
        heard.append(opened.run("document.getElementById('said').textContent"))
    assert all(" dB after " in said for said in heard) and len(set(heard)) == len(heard)
    assert heard[1].partition(":")[0] != heard[2].partition(":")[0]  # down goes to another curve


def test_a_curve_can_be_switched_off(opened: Page) -> None:
    before = opened.run("document.querySelectorAll('#chart svg > path').length")
    click(opened, "document.querySelector('#plot-legend button')")
    assert opened.run("document.querySelector('#plot-legend button').ariaPressed") == "false"
    assert opened.run("document.querySelectorAll('#chart svg > path').length") < before
    click(opened, "document.querySelector('#plot-legend button')")
    assert opened.run("document.querySelectorAll('#chart svg > path').length") == before


def test_time_is_on_a_log_axis(opened: Page) -> None:
    """Equal ratios of time are equal distances: by the marks of one run, whose times are in the data."""
    choose(opened, "plot-board", "fern_small, refocus-v3")
    choose(opened, "plot-score", "PSNR")
    run = next(
        one
        for one in json.loads(opened.run("document.getElementById('data').textContent"))["plots"]
        if (one["board"], one["column"]) == ("fern_small, refocus-v3", "psnr")
    )["series"][0]["runs"][0]["points"]
    drawn = opened.run("document.querySelector('#chart svg > path[stroke]').getAttribute('d')")
    xs = [float(point.split(",")[0]) for point in drawn[1:].split("L")]
    assert len(xs) == len(run) > 3
    ratios = [(x - xs[0]) / math.log(time / run[0][0]) for x, (time, _) in zip(xs[1:], run[1:], strict=True)]
    assert max(ratios) == pytest.approx(min(ratios), rel=DRAWN_PIXEL)


# ---- pictures ----


def test_the_slider_moves_by_key_and_by_mouse(opened: Page) -> None:
    choose(opened, "picture-board", "waves, refocus-v3")
    split = "document.getElementById('compare').style.getPropertyValue('--split')"
    opened.run("document.querySelector('#compare input').focus()")
    opened.key("ArrowRight")
    assert opened.run(split) == "51%"
    opened.key("ArrowLeft")
    opened.key("ArrowLeft")
    assert opened.run(split) == "49%"
    _, y = middle(opened, "document.getElementById('compare')")
    left, width = opened.run(
        "(({left, width}) => [left, width])(document.getElementById('compare').getBoundingClientRect())"
    )
    opened.mouse("moved", left + 0.2 * width, y)
    opened.mouse("pressed", left + 0.2 * width, y)
    opened.mouse("released", left + 0.2 * width, y)
    assert 15 <= float(opened.run(split).rstrip("%")) <= 25
    bar = opened.run("document.querySelector('#compare .bar').getBoundingClientRect().left")
    assert 0.15 < (bar - left) / width < 0.25


def test_truth_prediction_and_error_of_any_view(opened: Page) -> None:
    for board, views in (("waves, refocus-v3", 2), ("fern_small, refocus-v3", 3)):
        choose(opened, "picture-board", board)
        assert opened.run("document.getElementById('picture-view').options.length") == views
    names = opened.run("[...document.getElementById('picture-right').options].map((o) => o.textContent)")
    assert names[0] == "truth" and sum(name.startswith("error of ") for name in names) == 1
    assert opened.run("document.getElementById('picture-scale').hidden")
    choose(opened, "picture-right", next(name for name in names if name.startswith("error of fake")))
    assert not opened.run("document.getElementById('picture-scale').hidden")
    opened.wait("[...document.querySelectorAll('#compare img')].every((i) => i.complete && i.naturalWidth === 64)")
    assert opened.run("document.querySelector('#compare img.left').alt").startswith("truth")
    choose(opened, "picture-right", "pinhole quick, seed 0")
    assert "the method has no lens to refocus with" in opened.run(
        "document.getElementById('picture-missing').textContent"
    )
    choose(opened, "picture-kind", "all in focus")
    assert opened.run("document.getElementById('picture-missing').hidden")
    names = opened.run("[...document.getElementById('picture-right').options].map((o) => o.textContent)")
    assert opened.run("document.getElementById('picture-resolved').hidden")
    choose(opened, "picture-right", next(name for name in names if name.startswith("resolved, fake")))
    assert not opened.run("document.getElementById('picture-resolved').hidden")


# ---- any screen ----


@pytest.mark.parametrize(("width", "phone"), [(1280, False), (360, True)])
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_sticks_out_at_the_side(opened: Page, width: int, phone: bool, dark: bool) -> None:
    opened.size(width, 800, dark=dark, phone=phone)
    try:
        assert opened.run("[innerWidth, document.documentElement.scrollWidth]") == [width, width]
        light = opened.run("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)[0]")
        assert (light < 60) is dark
    finally:
        opened.size(1280, 900)


def test_all_of_that_was_silent(opened: Page) -> None:
    assert opened.errors == []
    assert len([url for url in opened.requests if not url.startswith("data:")]) == 1
