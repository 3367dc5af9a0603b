"""The mutation run of benchmarks/: what it changes and what it never does, the draw, and the verdict on a mutant."""

from __future__ import annotations

import ast
import csv
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
BESIDE = ROOT / "benchmarks"


@pytest.fixture
def sites(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BESIDE))
    return importlib.import_module("mutation_sites")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BESIDE))
    return importlib.import_module("mutation_run")


def _changes(sites: ModuleType, tmp_path: Path, text: str) -> set[tuple[str, str, str]]:
    (tmp_path / "a.py").write_text(text)
    return {(one.operator, one.before, one.after) for one in sites.mutants_of(tmp_path, "a.py")}


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("def f(x):\n    return x < 3\n", ("comparison swapped", "x < 3", "(x <= 3)")),
        ("def f(x):\n    return x < 3\n", ("comparison swapped", "x < 3", "(x >= 3)")),
        ("def f(x):\n    return x + 3\n", ("arithmetic swapped", "x + 3", "(x - 3)")),
        ("def f(x, y):\n    return x and y\n", ("boolean swapped", "x and y", "(x or y)")),
        ("def f(x):\n    if x:\n        g()\n", ("condition negated", "x", "(not x)")),
        ("LIMIT = 0.5\n", ("constant changed", "0.5", "1.0")),
        ("LIMIT = 0.5\n", ("constant changed", "0.5", "(-0.5)")),
        ("def f(x=2):\n    return x\n", ("default changed", "2", "0")),
        ("def f(x):\n    return x.detach()\n", ("call removed", "x.detach()", "x")),
        ("def f(x):\n    return min(x)\n", ("function swapped", "min(x)", "max(x)")),
        ("def f(x):\n    return x[1:]\n", ("slice shifted", "x[1:]", "x[1 + 1:]")),
        ("def f(x):\n    return x[1:]\n", ("slice shifted", "x[1:]", "x[1:-1]")),
        ("def f(x, y):\n    return x, y\n", ("return value swapped", "return x, y", "return (y, x)")),
        ("def f(x):\n    x.y = 1\n    return x\n", ("statement deleted", "x.y = 1", "pass")),
        ("def f(x, y):\n    return g(x, y)\n", ("arguments swapped", "g(x, y)", "g(y, x)")),
        ("def f(x):\n    return g(x, dim=x)\n", ("argument dropped", "g(x, dim=x)", "g(x)")),
        ("def f(x):\n    x += 1\n    return x\n", ("arithmetic swapped", "x += 1", "x -= 1")),
    ],
)
def test_each_kind_of_change(sites: ModuleType, tmp_path: Path, text: str, change: tuple[str, str, str]) -> None:
    assert change in _changes(sites, tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        '"""A text with 3 numbers."""\n',
        '__all__ = ["f"]\n',
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    LIMIT = 3\n",
        "class Shape(Protocol):\n    sides = 3\n\n    def area(self, scale=2): ...\n",
        "import os\n",
        "SIZE: tuple[3, 4]\n",
        "def f(x: Literal[3]):\n    raise InputError(f'{x + 1}', 'found' + str(3), 'four')\n",
        "def f(x):\n    assert x > 3\n",
        "@overload\ndef f(x=3): ...\n",
        "@cache(size=3)\ndef f(x): ...\n",
    ],
)
def test_what_is_never_changed(sites: ModuleType, tmp_path: Path, text: str) -> None:
    assert _changes(sites, tmp_path, text) == set()


def test_what_only_tells_stays(sites: ModuleType, tmp_path: Path) -> None:
    told = "def f(x, progress):\n    progress('step', x + 1, 3)\n    return x\n"
    assert {operator for operator, _, _ in _changes(sites, tmp_path, told)} == {"return value dropped"}
    idle = "def f(x, y):\n    return zip(x, y, strict=True)\n"
    assert {after for _, _, after in _changes(sites, tmp_path, idle)} == {"return None", "zip(y, x, strict=True)"}
    free = "@torch.no_grad()\ndef f(x):\n    return x.detach()\n"
    assert {after for _, _, after in _changes(sites, tmp_path, free)} == {"return None"}
    same = "def f(x, y):\n    return max(x, y)\n"
    assert {after for _, _, after in _changes(sites, tmp_path, same)} == {"return None", "min(x, y)"}


@pytest.mark.parametrize(
    "file", ["dofbench/optics/layered.py", "dofbench/gaussians/density.py", "kernels/ssim/reference.py"]
)
def test_a_mutant_is_code_and_another_one(sites: ModuleType, file: str) -> None:
    text = (ROOT / file).read_text()
    whole, found = ast.dump(ast.parse(text)), sites.mutants_of(ROOT, file)
    assert len({one.id for one in found}) == len(found) > 100
    for one in found:
        changed = one.applied(text)
        compile(changed, file, "exec")
        assert ast.dump(ast.parse(changed)) != whole, one


def test_a_draw_stays_while_other_code_changes(run: ModuleType, sites: ModuleType, tmp_path: Path) -> None:
    def functions(numbers: range) -> str:
        return "".join(f"def f{n}(x):\n    y = x + {n + 2}\n    return y * x\n\n\n" for n in numbers)

    def drawn(text: str, seed: int, count: int) -> set[str]:
        (tmp_path / "a.py").write_text(text)
        return {one.id for one in run.draw(sites.mutants_of(tmp_path, "a.py"), seed, count)}

    few, many = drawn(functions(range(40)), 14, 20), drawn(functions(range(40)), 14, 60)
    assert len(few) == 20 and few < many
    assert drawn(functions(range(40)), 15, 20) != few
    # Half as much code again, before and behind: what stays drawn are the same mutants of the same statements.
    grown = drawn("LIMIT = 3\n\n\n" + functions(range(60)), 14, 20)
    assert len(grown & few) >= 8
    assert drawn(functions(range(60)), 14, 60) & few == few


SMALL = """import os


def twice(x):
    if x > 100:
        while True:
            pass
    return 2 * x


def idle(x):
    return x + 0


LIMIT = 3
"""
SMALL_TESTS = """import pytest

from dofbench.optics import small

CALLS = []


def test_twice():
    assert small.twice(4) == 8


def test_idle():
    assert small.idle(4) == 4


def test_limit():
    assert small.LIMIT == 3


def test_in_the_wrong_order():
    CALLS.append(1)
    assert len(CALLS) == 1 and "test_idle" not in CALLS


def test_fails_anyway():
    assert small.idle(4) == 5
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A checkout of one module and its tests."""
    for folder in ("dofbench/optics", "tests"):
        (tmp_path / folder).mkdir(parents=True)
    for folder in ("dofbench", "dofbench/optics"):
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "dofbench/optics/small.py").write_text(SMALL)
    (tmp_path / "tests/test_small.py").write_text(SMALL_TESTS)
    (tmp_path / "tests/conftest.py").write_text(
        "from hypothesis import settings\nsettings.register_profile('dofbench')\nsettings.load_profile('dofbench')\n"
    )
    return tmp_path


def _child(project: Path, what: str, order: dict[str, Any]) -> list[dict[str, Any]]:
    file = project / "order.json"
    file.write_text(json.dumps({"sources": ["dofbench/optics/small.py"], "temporary": str(project / "t"), **order}))
    reader, writer = os.pipe()
    start = "import mutation_child; mutation_child.main()"
    command = [sys.executable, "-c", start, what, str(file), "tests/test_small.py"]
    environment = os.environ | {"PYTHONPATH": str(BESIDE), "MUTATION_ANSWERS": str(writer)}
    subprocess.run(command, cwd=project, env=environment, pass_fds=[writer], capture_output=True)
    os.close(writer)
    with os.fdopen(reader) as answers:
        return [json.loads(line) for line in answers]


def test_the_verdict_on_a_mutant(project: Path) -> None:
    def job(mark: str, before: str, after: str, *tests: str) -> dict[str, Any]:
        names = [(f"tests/test_small.py::test_{test}", 0.01) for test in tests]
        return {"id": mark, "file": "dofbench/optics/small.py", "mutated": SMALL.replace(before, after), "tests": names}

    jobs = [
        job("killed", "2 * x", "3 * x", "idle", "twice"),
        job("alive", "x + 0", "x - 0", "twice", "idle"),
        job("endless", "x > 100", "x < 100", "twice"),
        job("crash", "return 2 * x", "os.abort()", "twice"),
        job("import", "LIMIT = 3", "LIMIT = 4", "limit"),
        job("fails anyway", "x + 0", "x * 1", "fails_anyway", "idle"),
        job("nobody", "2 * x", "3 * x"),
        job("killed again", "2 * x", "x", "twice"),
    ]
    answers = {one["id"]: one for one in _child(project, "serve", {"jobs": jobs, "grace": 2.0})}
    assert {mark: one["outcome"] for mark, one in answers.items()} == {
        "killed": "failed",
        "alive": "survived",
        "endless": "timed out",
        "crash": "crashed",
        "import": "unchanged",  # is run in a process of its own
        "fails anyway": "survived",
        "nobody": "not run by any test",
        "killed again": "failed",  # a mutant leaves nothing behind
    }
    assert answers["killed"]["test"] == answers["crash"]["test"] == "tests/test_small.py::test_twice"


def test_the_map_of_lines_and_tests(project: Path) -> None:
    pytest.importorskip("coverage", reason="the mutation run measures by coverage.py which test runs which line")
    out = project / "map.json"
    _child(project, "map", {"out": str(out)})
    found = json.loads(out.read_text())
    names = [test["name"].partition("::test_")[2] for test in found["tests"]]
    assert {name for name, test in zip(names, found["tests"], strict=True) if not test["passed"]} == {"fails_anyway"}
    ran = {
        int(line): {names[one] for one in those} for line, those in found["lines"]["dofbench/optics/small.py"].items()
    }
    doubled = SMALL.splitlines().index("    return 2 * x") + 1
    assert ran[doubled] == {"twice"}
    assert doubled - 2 not in ran  # the loop, which no test runs
    assert ran[SMALL.splitlines().index("    return x + 0") + 1] == {"idle", "fails_anyway"}


def test_the_page_counts_and_gives_reasons(run: ModuleType, tmp_path: Path) -> None:
    def row(mark: str, outcome: str) -> dict[str, str]:
        known = {"id": mark, "outcome": outcome, "file": "dofbench/optics/tone.py", "operator": "condition negated"}
        return dict.fromkeys(run.FIELDS, "") | known | {"seconds": "1", "before": "a | b", "after": "a"}

    rows = [row("a", "failed"), row("b", "timed out"), row("c", "survived"), row("d", "survived")]
    (tmp_path / "survivors.toml").write_text('[c]\nkind = "equivalent"\nreason = "Both are the same."\n')
    run.write_page(tmp_path, rows, seed=14, count=4, killed=run.KILLED)
    page = (tmp_path / "README.md").read_text()
    assert "Of 4 mutants drawn at random, 2 were killed: **50.0 %**" in page
    assert "1 of the survivors are equivalent to the code; of all others 66.7 % were killed." in page
    assert "| optics | 4 | 2 | 50.0 % |" in page
    assert page.index("Equivalent") < page.index("Both are the same.") < page.index("Without a reason")
    assert "`a \\| b`" in page
    run.write_page(tmp_path, rows[2:3], seed=14, count=4, killed=run.KILLED)  # as after the first mutant of a run
    assert "of all others – were killed." in (tmp_path / "README.md").read_text()


def test_what_is_known_is_not_run_again(run: ModuleType) -> None:
    killed, alive = ({"id": "m", "outcome": outcome, "code": "1", "suite": "1"} for outcome in ("failed", "survived"))
    assert run._holds(killed, "1", "2", ()) and not run._holds(killed, "2", "1", ())
    assert run._holds(alive, "1", "1", ()) and not run._holds(alive, "1", "2", ())
    assert run._holds(alive, "1", "2", {"m"}) and not run._holds(alive, "2", "2", {"m"})  # equivalent to this code


def test_the_published_page_is_what_its_csv_says(run: ModuleType, tmp_path: Path) -> None:
    published = ROOT / "reports" / "mutation"
    for name in ("survivors.toml", "fresh/mutants.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((published / name).read_bytes())
    rows = list(csv.DictReader((published / "mutants.csv").open()))
    run.write_page(tmp_path, rows, seed=16, count=300, killed=run.KILLED)
    machine = re.compile(r", in \S+ \S+ on one core of \S+\. Every")
    made, page = (
        machine.sub(". Every", (folder / "README.md").read_text(encoding="utf-8")) for folder in (tmp_path, published)
    )
    assert made == page
    assert len(rows) >= 300 and sum(row["outcome"] in run.KILLED for row in rows) >= 0.95 * len(rows)
