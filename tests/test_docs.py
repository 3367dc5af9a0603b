"""The pages are right: links are valid, commands can be parsed, and the instructions of a page work when they are
carried out."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from doc_pages import Block, anchors, blocks, commands, links

import dofbench
from dofbench.cli import app

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted(path for folder in ("docs", "examples", "benchmarks", "reports") for path in (ROOT / folder).rglob("*.md")),
    ROOT / "datasets" / "depthnet" / "README.md",
]
GUIDES = sorted((ROOT / "docs").glob("*.md"))


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


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


# ---- command lines ----


CALLS = [pytest.param(words, id=f"{name(page)}: {' '.join(words)}") for page in PAGES for words in commands(page)]


@pytest.mark.parametrize("words", CALLS)
def test_command_lines_parse(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands aren't run. Words in capitals stand for the user's own names."""
    if words in (["COMMAND", "--help"], ["--version"]):
        return
    shown = [word.strip("[]").replace("$scene", "fence") for word in words if word not in ("...", "...]", "…")]
    try:
        app.parse(shown)
    except SystemExit as end:
        assert end.code == 0 and "--help" in shown, "the command line isn't one"


# ---- the API page ----


def test_the_api_page_has_every_public_name() -> None:
    listed = re.findall(r"^::: dofbench\.(\w+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(dofbench.__all__)


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


@pytest.mark.slow
def test_a_method_as_the_page_adds_it(done) -> None:
    place = done(ROOT / "docs" / "add-a-method.md", ROOT)
    assert (place / "reports" / "nearest" / "report.html").is_file()


@pytest.mark.slow
def test_another_program_as_the_page_adds_it(done) -> None:
    place = done(ROOT / "docs" / "external-methods.md", ROOT)
    assert (place / "reports" / "copies" / "report.html").is_file()


def test_a_reader_as_the_page_adds_it(done, tree: Path) -> None:
    done(ROOT / "docs" / "add-a-reader.md", tree)


@pytest.mark.slow
def test_a_kernel_backend_as_the_page_adds_it(done, tree: Path) -> None:
    done(ROOT / "docs" / "add-a-kernel-backend.md", tree)


def test_a_metric_as_the_page_adds_it(done, tree: Path) -> None:
    place = done(ROOT / "docs" / "add-a-metric.md", tree)
    asked = [sys.executable, "-m", "dofbench", "score", ".", "--metrics", "nothing"]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    said = subprocess.run(asked, cwd=place, env=environment, capture_output=True, text=True, check=False).stderr
    assert "aif_mae" in said, "the metrics that score can add are named"


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [ROOT / "README.md", ROOT / "docs" / "conventions.md", ROOT / "docs" / "python.md"], ids=name
)
def test_python_on_a_page_runs(done, page: Path) -> None:
    assert any(block.language == "python" for block in blocks(page))
    done(page, ROOT)


def test_the_snippet_that_renders_another_programs_ply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """docs/methods.md shows it for a scene.ply and a camera that the reader has."""
    from random_gaussians import scene, view

    from dofbench.training.gaussians.model import Gaussians
    from dofbench.training.gaussians.splats import write_splats

    (block,) = [block for block in blocks(ROOT / "docs" / "methods.md") if block.language == "python"]
    write_splats(tmp_path / "scene.ply", Gaussians(scene(20, seed=0)))
    monkeypatch.chdir(tmp_path)
    names = {"camera": view(60, 50)}
    exec(block.text, names)
    assert names["rendering"].image.shape == (50, 60, 3) and np.isfinite(names["rendering"].image).all()
