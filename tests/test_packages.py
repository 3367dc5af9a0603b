"""The declared order of packages: imports only from earlier packages, no import cycles, and unique module names."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from import_walk import arrows, modules, package_of

ROOT = Path(__file__).resolve().parent.parent
ORDER: list[str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["dofbench"]["packages"]
# Names that several modules may have, because they are the same part of different things.
SAME_NAMES = {"cpu", "gpu", "reference", "schema", "method"}


def upward(root: Path, order: list[str]) -> list[str]:
    """Each import from a later or an undeclared package, with what to do about it."""
    wrong = []
    known = modules(root)
    for name, target in sorted(set(arrows(known))):
        here, there = package_of(name), package_of(target)
        if not here or not there or here == there:
            continue
        if missing := [package for package in (here, there) if package not in order]:
            wrong.append(f"{missing[0]} isn't declared: give it a place in [tool.dofbench] packages of pyproject.toml")
        elif order.index(there) > order.index(here):
            wrong.append(
                f"{name} imports {target}, but {here} comes before {there}: move what {name} needs down to {here} or "
                f"below, move {name} up to {there} or above, or hand it over as an argument"
            )
    return wrong


def circle(root: Path) -> str:
    """The modules of an import cycle, or "" without one."""
    below: dict[str, set[str]] = defaultdict(set)
    known = modules(root)
    for name, target in arrows(known, checked_only=True):
        if target in known:
            below[name].add(target)
    try:
        tuple(TopologicalSorter(below).static_order())
    except CycleError as found:
        return " -> ".join(found.args[1])
    return ""


def test_arrows_run_down_only() -> None:
    assert upward(ROOT, ORDER) == []


def test_no_circle_of_modules() -> None:
    assert circle(ROOT) == ""


def test_every_declared_package_is_there_and_nothing_lies_loose_on_top() -> None:
    on_top = {path.stem for path in (ROOT / "dofbench").iterdir() if not path.name.startswith("_")}
    assert on_top == set(ORDER)
    assert {path.name for path in (ROOT / "dofbench").glob("*.py")} == {
        "__init__.py",
        "__main__.py",
        "cli.py",
        "entry.py",
    }


def test_no_two_modules_of_one_name() -> None:
    """A module is known by its last name alone, as a traceback, an editor's tab and a search show it."""
    places = defaultdict(list)
    for name, file in modules(ROOT).items():
        if file.name != "__init__.py":
            places[name.split(".")[-1]].append(name)
    doubled = {last: names for last, names in places.items() if len(names) > 1 and last not in SAME_NAMES}
    assert doubled == {}, "give each a name that says what it holds"


@pytest.fixture
def tree(tmp_path: Path):
    """A function that writes a small tree of two packages, low and high; each given a module's text."""

    def write(low: str, high: str = "") -> Path:
        for name, text in (("low", low), ("high", high)):
            folder = tmp_path / "dofbench" / name
            folder.mkdir(parents=True)
            (folder / "__init__.py").touch()
            (folder / f"in_{name}.py").write_text(text)
        return tmp_path

    return write


@pytest.mark.parametrize(
    "text",
    [
        "from dofbench.high import in_high",
        "from dofbench.high.in_high import x",
        "import dofbench.high.in_high",
        "from dofbench import high",
        "def later():\n    from dofbench.high.in_high import x",
        "if TYPE_CHECKING:\n    from dofbench.high.in_high import x",
    ],
)
def test_an_arrow_that_runs_up_is_seen_and_told_what_to_move(tree, text: str) -> None:
    (said,) = upward(tree(text), ["low", "high"])
    assert said.startswith("low.in_low imports high") and "move" in said


def test_an_undeclared_package_is_seen(tree) -> None:
    (said,) = upward(tree("", "from dofbench.low import in_low"), ["low"])
    assert "high isn't declared" in said


def test_a_circle_is_seen(tree) -> None:
    found = circle(tree("from dofbench.high import in_high", "def f():\n    from dofbench.low import in_low"))
    assert "low.in_low" in found and "high.in_high" in found
