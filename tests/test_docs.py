"""The pages are right: links are valid, commands can be parsed, and the instructions of a page work when they are
carried out."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from doc_pages import Block, anchors, blocks, commands, links

from dofbench import METRICS, cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted(path for folder in ("docs", "examples", "benchmarks", "reports") for path in (ROOT / folder).rglob("*.md")),
    ROOT / "datasets" / "depthnet" / "README.md",
]
GUIDES = sorted((ROOT / "docs").glob("*.md"))
LONGEST_README = 120  # lines


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def table_column(page: Path, heading: str) -> list[str]:
    """The first cells, without backticks, of the table whose first heading this is."""
    lines = page.read_text().splitlines()
    (start,) = [number for number, line in enumerate(lines) if line.startswith(f"| {heading} |")]
    cells = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        cells.append(line.split("|")[1].strip().strip("`"))
    return cells


# ---- links ----


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in links(page):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        file = (page.parent / place).resolve() if place else page
        assert file.exists(), f"{target}: no such file"
        if anchor:
            assert file.suffix == ".md" and anchor in anchors(file), f"{target}: no such heading"


def test_every_guide_is_listed_and_reachable_from_the_readme() -> None:
    found, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        for target in links(page):
            file = (page.parent / target.partition("#")[0]).resolve()
            if file.suffix == ".md" and file.is_relative_to(ROOT) and file not in found and file.is_file():
                found.add(file)
                waiting.append(file)
    written = {page for page in PAGES if page.parent in (ROOT, ROOT / "docs") or page.name == "README.md"}
    assert written - found <= {ROOT / "README.md"}  # the tables of a report are reached from its README or page
    listed = {(ROOT / "docs" / target).resolve() for target in links(ROOT / "docs" / "README.md")}
    assert set(GUIDES) - listed <= {ROOT / "docs" / "README.md"}


def test_what_code_refers_to_is_there() -> None:
    """Comments say `docs/conventions.md, "Lens"`: page and heading."""
    found = 0
    for folder in ("dofbench", "kernels", "methods", "tests", "benchmarks"):
        for file in (ROOT / folder).rglob("*.py"):
            if file == Path(__file__).resolve():
                continue
            for page, heading in re.findall(r'docs/([\w-]+\.md)(?:, "([^"]+)")?', file.read_text()):
                found += 1
                assert (ROOT / "docs" / page).is_file(), f"{file}: docs/{page}"
                if heading:
                    assert re.search(rf"^#+ {re.escape(heading)}$", (ROOT / "docs" / page).read_text(), re.MULTILINE)
            assert not re.search(r"(?<![\w/-])(conventions|methods|kernels|architecture)\.md", file.read_text()), file
    assert found


# ---- command lines ----


CALLS = [pytest.param(words, id=f"{name(page)}: {' '.join(words)}") for page in PAGES for words in commands(page)]


@pytest.mark.parametrize("words", CALLS)
def test_command_lines_parse(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands aren't run. Words in capitals stand for the user's own names."""
    if words in (["COMMAND", "--help"], ["--version"]):
        return
    shown = [word.strip("[]").replace("$scene", "fence") for word in words if word not in ("...", "...]", "…")]
    try:
        cli.parse(shown)
    except SystemExit as end:
        assert end.code == 0 and "--help" in shown, "the command line isn't one"


def test_command_lines_are_found() -> None:
    assert len(CALLS) > 60
    with pytest.raises(SystemExit) as end:
        cli.parse(["make-dataset", "--no-such-option"])
    assert end.value.code == 2


# ---- README ----


def test_the_readme_is_a_page_with_both_set_ups() -> None:
    readme = ROOT / "README.md"
    assert len(readme.read_text().splitlines()) <= LONGEST_README
    marked = {block.mark: block for block in blocks(readme) if block.mark.startswith("set-up")}
    assert set(marked) == {"set-up: run", "set-up: test"}
    assert all(len(block.text.splitlines()) == 1 for block in marked.values())
    assert len(re.findall(r"^!\[", readme.read_text(), re.MULTILINE)) == 1


# ---- tables that repeat what code says ----


def test_tables_say_what_there_is() -> None:
    docs = ROOT / "docs"
    assert table_column(docs / "results.md", "id") == list(METRICS)
    for metric_id, metric in METRICS.items():
        row = f"| `{metric_id}` | {metric.label} | {metric.unit}".rstrip()
        better = "higher" if metric.higher_is_better else "lower"
        assert re.search(rf"^{re.escape(row)} *\| {better} \|$", (docs / "results.md").read_text(), re.MULTILINE)
    ops = {path.name for path in (ROOT / "kernels").iterdir() if any(path.glob("*.py"))}
    assert set(table_column(docs / "kernels.md", "op")) == ops
    cards = {path.parent.name: tomllib.loads(path.read_text()) for path in (ROOT / "methods").glob("*/method.toml")}
    assert set(table_column(docs / "methods.md", "id")) == set(cards)
    presets = table_column(docs / "methods.md", "preset")
    assert set(presets) == set(cards["dofgaussian"]["presets"])
    assert set(cards["mipsplatting"]["presets"]) == {"cpu", "gpu", "quick", "smoke"}  # as the page says
    tables = tomllib.loads((ROOT / "methods" / "dofgaussian" / "ablations.toml").read_text())["tables"]
    assert set(table_column(docs / "ablations.md", "`--table`")) == {table["id"] for table in tables}
    named = {file.stem for file in (ROOT / "datasets").glob("*.toml")}
    text = (docs / "datasets.md").read_text()
    assert all(f"`{one}`" in text for one in named - {"tabletop"})


# ---- pages that are done as they say ----


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the program that a page may change; content that no page changes is lent."""
    copy = tmp_path / "tree"
    for folder in ("dofbench", "kernels", "methods"):
        shutil.copytree(ROOT / folder, copy / folder)
    for folder in ("datasets", "reports"):
        (copy / folder).symlink_to(ROOT / folder)
    return copy


@pytest.fixture
def done(tmp_path: Path) -> Callable[[Path, Path], None]:
    """A function that does what a page says: writes its files, makes its changes, runs its blocks."""
    place = tmp_path / "place"
    place.mkdir()
    program = tmp_path / "bin" / "dofbench"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m dofbench "$@"\n')
    program.chmod(0o755)

    def do(page: Path, code: Path) -> Path:
        environment = {
            **os.environ,
            "PYTHONPATH": str(code),
            "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}",
        }
        for block in blocks(page):
            if block.mark == "run":
                command = ["bash", "-euo", "pipefail", "-c"] if block.language == "sh" else [sys.executable, "-c"]
                run = subprocess.run(
                    [*command, block.text], cwd=place, env=environment, capture_output=True, text=True, check=False
                )
                assert run.returncode == 0, f"{block.text}\n{run.stdout}\n{run.stderr}"
            else:
                _write(block, place, code)
        return place

    return do


def _write(block: Block, place: Path, code: Path) -> None:
    """Make the file, or the change of a file, that a marked block is: in the copy of the program, or beside it."""
    kind, _, rest = block.mark.partition(": ")
    file, _, line = rest.partition(" after: ")
    target = (code if file.startswith(("dofbench/", "kernels/")) else place) / file
    if kind == "file":
        assert not target.exists()
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(block.text)
    elif kind == "in":
        text = target.read_text()
        (found,) = [one for one in text.splitlines(keepends=True) if one.strip() == line]
        target.write_text(text.replace(found, found + block.text, 1))


def test_a_method_as_the_page_adds_it(done) -> None:
    place = done(ROOT / "docs" / "add-a-method.md", ROOT)
    assert (place / "reports" / "nearest" / "report.html").is_file()


def test_another_program_as_the_page_adds_it(done) -> None:
    place = done(ROOT / "docs" / "external-methods.md", ROOT)
    assert (place / "reports" / "copies" / "report.html").is_file()


def test_a_reader_as_the_page_adds_it(done, tree: Path) -> None:
    done(ROOT / "docs" / "add-a-reader.md", tree)


def test_a_kernel_backend_as_the_page_adds_it(done, tree: Path) -> None:
    done(ROOT / "docs" / "add-a-kernel-backend.md", tree)


def test_a_metric_as_the_page_adds_it(done, tree: Path) -> None:
    place = done(ROOT / "docs" / "add-a-metric.md", tree)
    asked = [sys.executable, "-m", "dofbench", "score", ".", "--metrics", "nothing"]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    said = subprocess.run(asked, cwd=place, env=environment, capture_output=True, text=True, check=False).stderr
    assert "aif_mae" in said, "the metrics that score can add are named"


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs" / "conventions.md"], ids=name)
def test_python_on_a_page_runs(done, page: Path) -> None:
    assert any(block.language == "python" for block in blocks(page))
    done(page, ROOT)


def test_the_snippet_that_renders_another_programs_ply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """docs/methods.md shows it for a scene.ply and a camera that the reader has."""
    from random_gaussians import scene, view

    from dofbench.gaussians.model import Gaussians
    from dofbench.gaussians.splats import write_splats

    (block,) = [block for block in blocks(ROOT / "docs" / "methods.md") if block.language == "python"]
    write_splats(tmp_path / "scene.ply", Gaussians(scene(20, seed=0)))
    monkeypatch.chdir(tmp_path)
    names = {"camera": view(60, 50)}
    exec(block.text, names)
    assert names["rendering"].image.shape == (50, 60, 3) and np.isfinite(names["rendering"].image).all()


def test_every_python_block_of_a_guide_is_tried() -> None:
    pages = [ROOT / "README.md", *GUIDES]
    shown = {name(page) for page in pages for one in blocks(page) if one.language == "python" and not one.mark}
    assert shown == {"docs/methods.md"}
