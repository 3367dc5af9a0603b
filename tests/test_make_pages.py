"""The generator of report pages: what a template can look up, and how it fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.make_pages import main

CSV = """method,scene,seed,psnr,note
3dgs,fern,0,26.701,a|b
3dgs,fern,1,26.9,
nerf,fern,0,-0.001,
nerf,fox,0,,
"""

OPTIONS = """method,preset,against_method,against_preset
dofgs,"short, code 1a2b",nerf,cpu-v2
dofgs,"short sh_degree=3 a=0, code 1a2b",nerf,cpu-v2 b=1
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A checkout with one topic, whose template a test writes."""
    for folder in ("benchmarks", "reports"):
        (tmp_path / folder / "lens").mkdir(parents=True)
    (tmp_path / "reports" / "lens" / "a.csv").write_text(CSV)
    (tmp_path / "reports" / "lens" / "o.csv").write_text(OPTIONS)
    (tmp_path / "reports" / "lens" / "exact.csv").write_text("psnr\n40\ninf\n")
    return tmp_path


def make(tree: Path, template: str, *words: str, name: str = "page") -> int:
    (tree / "benchmarks" / "lens" / f"{name}.md.j2").write_text(template)
    status: int = main(words, root=tree)
    return status


@pytest.mark.parametrize(
    ("template", "expected"),
    [
        ("{{ value('a.csv', 'psnr', method='3dgs', seed=1)|fixed(1) }} dB", "26.9 dB"),
        ("{{ (value('a.csv', 'psnr', seed=1) - value('a.csv', 'psnr', method='3dgs', seed=0))|signed(3) }}", "+0.199"),
        ("{{ value('a.csv', 'psnr', method='nerf', scene='fern')|signed(2) }}", "0.00"),
        ("{{ mean(rows('a.csv', method='3dgs'), 'psnr')|fixed(2) }}", "26.80"),
        ("{{ mean(rows('a.csv', method='nerf'), 'psnr')|digits(1) }}", "-0.001"),  # an empty cell doesn't count
        ("{{ rows('a.csv')|where(method='3dgs')|shown('psnr', 1, spread=true) }}", "26.8 ± 0.1"),
        ("{{ rows('a.csv')|where(method='nerf', scene='fox')|shown('psnr') }}", "–"),
        (
            "{{ ranked(rows('a.csv'), 'scene', 'psnr')|join }} {{ ranked(rows('a.csv'), 'method', 'psnr')|join }}",
            "fern 3dgsnerf",
        ),
        ("{{ exponent([{'n': 1, 's': 9}, {'n': 10, 's': 2}, {'n': 100, 's': 200}], 's', 'n', 5)|fixed(1) }}", "2.0"),
        ("{{ exponent([{'n': 10, 's': 0}, {'n': 100, 's': 1}], 's', 'n') }}", "–"),
        (
            "{% for r in rows('o.csv')|variants %}{{ r.method }}/{{ r.preset }}>{{ r.against_method }} {% endfor %};",
            "dofgs/short>nerf dofgs sh_degree=3 a=0/short>nerf b=1 ;",
        ),
        (
            "{{ rows('a.csv', scene=['fern', 'fox'])|length }} {{ 0.5|percent }} {{ 195957|thousands }}",
            "4 50 % 195 957",
        ),
        (
            "{{ table(rows('a.csv', method='3dgs'), {'psnr': 'PSNR [dB]', 'note': 'note'}, {'psnr': 2}) }}",
            "| PSNR [dB] | note |\n| ---: | --- |\n| 26.70 | a\\|b |\n| 26.90 |  |",
        ),
    ],
)
def test_a_page_states_what_its_csv_holds(tree: Path, template: str, expected: str) -> None:
    assert make(tree, template + "\n") == 0
    assert (tree / "reports" / "lens" / "README.md").read_text() == expected + "\n"


@pytest.mark.parametrize(
    ("template", "problem"),
    [
        ("\n{{ value('b.csv', 'psnr') }}", "page.md.j2:2: b.csv"),
        ("{{ value('a.csv', 'psnr', method='none') }}", "page.md.j2:1: a.csv: no row with {'method': 'none'}"),
        ("{{ value('a.csv', 'psnr', method='3dgs') }}", "2 rows"),
        ("{{ value('a.csv', 'ssim', seed=1) }}", "no column 'ssim'"),
        ("{{ rows('a.csv', lens=1) }}", "no column 'lens'"),
        ("{{ rows('a.csv')[0].ssim }}", "ssim"),
        ("{{ absent }}", "'absent' is undefined"),
        ("{{ value('a.csv', 'psnr', scene='fox')|fixed }}", "a number is needed"),
        ("{{ mean(rows('a.csv'), 'note') }}", "numbers are needed"),
        ("\n\n{% for %}", "page.md.j2:3"),
    ],
)
def test_what_is_missing_is_one_line(
    tree: Path, template: str, problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert make(tree, template) == 2
    said = capsys.readouterr().err
    assert problem in said and said.count("\n") == 1
    assert not (tree / "reports" / "lens" / "README.md").exists()


def test_check_writes_nothing_and_shows_the_difference(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tree / "reports" / "lens" / "basin.md"
    template = "PSNR {{ value('a.csv', 'psnr', seed=1) }}\n"
    assert make(tree, template, "--check", name="basin") == 1 and not page.exists()
    assert make(tree, template, name="basin") == 0 == main(["--check"], root=tree)
    page.write_text("PSNR 30\n")
    capsys.readouterr()
    assert main(["--check"], root=tree) == 1 and page.read_text() == "PSNR 30\n"
    said = capsys.readouterr().out
    assert "-PSNR 30\n" in said and "+PSNR 26.9\n" in said


def test_topics_are_chosen(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "benchmarks" / "other").mkdir()
    (tree / "benchmarks" / "other" / "page.md.j2").write_text("{{ absent }}")
    assert make(tree, "text\n", "lens") == 0
    assert main([], root=tree) == 2 and main(["lense"], root=tree) == 2
    assert "the topics are lens, other" in capsys.readouterr().err
