"""Stored results are outdated by exactly those changes of code that they depend on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dofbench.core import import_closure, source_graph
from dofbench.core.content import content_folder
from dofbench.core.import_closure import closure, closure_digest, own_sources
from dofbench.core.source_graph import Sources
from dofbench.results import provenance
from dofbench.stability import unfinished
from dofbench.stability.stability_options import GROUPS

ENTRY = "dofbench.low.entry:wanted"
RENDERER_SCORES = ["dofbench.validation.renderer_scores:score", "dofbench.validation.variants:VARIANTS"]


@pytest.fixture
def tree(tmp_path: Path):
    """A function that writes modules (path below dofbench/ -> text) and gives the digest of what ENTRY reaches."""

    def digest(files: dict[str, str]) -> str:
        shutil.rmtree(tmp_path / "dofbench", ignore_errors=True)
        for name, text in {"__init__.py": "", "low/__init__.py": "", "low/entry.py": "", **files}.items():
            file = tmp_path / "dofbench" / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        source_graph._read.cache_clear()  # files of one size may follow each other within one tick of the clock
        return closure_digest([ENTRY], Sources({"dofbench": tmp_path / "dofbench"}))

    return digest


USES = [
    "from dofbench.low.constants import FACTOR\ndef wanted(): return FACTOR",
    "from dofbench.low.constants import FACTOR as f\ndef wanted(): return f",
    "from dofbench.low import constants\ndef wanted(): return constants.FACTOR",
    "from dofbench.low import constants as c\ndef wanted(): return c.FACTOR",
    "import dofbench.low.constants\ndef wanted(): return dofbench.low.constants.FACTOR",
    "from .constants import FACTOR\ndef wanted(): return FACTOR",
    "from . import constants\ndef wanted(): return constants.FACTOR",
    "def wanted():\n    from dofbench.low.constants import FACTOR\n    return FACTOR",
    "def wanted(name): return import_module(f'dofbench.low.{name}')",
    "def wanted(): return import_module('dofbench.low.constants')",
    "from dofbench.low import constants\ndef wanted(): return vars(constants)",
    "from dofbench.low.constants import FACTOR\nhalf = FACTOR / 2\ndef one(): return half\ndef wanted(): return one()",
    "from dofbench.low.constants import FACTOR\nclass A:\n    x: int = FACTOR\ndef wanted(a: A): return a.x",
    "from dofbench.low.constants import FACTOR\n@register\ndef other(): return FACTOR\ndef wanted(): return 1",
    "from dofbench.low.constants import FACTOR\nnp.seterr(FACTOR)\ndef wanted(): return 1",
]


@pytest.mark.parametrize("use", USES)
def test_a_constant_in_another_module_is_reached(tree, use: str) -> None:
    before = tree({"low/entry.py": use, "low/constants.py": "FACTOR = 2"})
    assert tree({"low/entry.py": use, "low/constants.py": "FACTOR = 3"}) != before


@pytest.mark.parametrize(
    "other",
    [
        "# a comment\nFACTOR = 2\n",
        '"""Words."""\nFACTOR = 2\n',
        "FACTOR = 2\nUNUSED = 3\n",
        "FACTOR = 2\ndef unused(): return 5\n",
        "from __future__ import annotations\n\nFACTOR = 2\n",
        "FACTOR = 2\n__all__ = ['FACTOR']\n",
    ],
)
def test_what_stands_beside_is_not(tree, other: str) -> None:
    before = tree({"low/entry.py": USES[0], "low/constants.py": "FACTOR = 2"})
    assert tree({"low/entry.py": USES[0], "low/constants.py": other}) == before


def test_words_of_an_error_and_docstrings_may_change(tree) -> None:
    code = 'def wanted(x):\n    """{}"""\n    if x > {}:\n        raise ValueError("{}")\n    return x\n'
    before = tree({"low/entry.py": code.format("Words.", 1, "too large")})
    assert tree({"low/entry.py": code.format("Others.", 1, "larger than 1")}) == before
    assert tree({"low/entry.py": code.format("Words.", 2, "too large")}) != before


BRIDGE = """
from dofbench.low.files import found
def load(op, backend="auto"): return _module(op, backend)
def others(op): return found(op)
def _module(op, backend): return import_module(f"dofbench.kernels.{op}.{backend}")
"""
KERNELS = {
    "low/files.py": "def found(op): return 1",
    "kernels/__init__.py": BRIDGE,
    "kernels/blur/__init__.py": "",
    "kernels/blur/cpu.py": "from .cpu_part import HALF\nTWICE = 2\ndef blur(): return HALF",
    "kernels/blur/cpu_part.py": "HALF = 2",
    "kernels/tone/reference.py": "ZERO = 2",
}
# Where a change of one kernel is looked for in what calls only the other: op's files, and what changes them.
NAMED = [
    "from dofbench.kernels import load\ndef wanted(): return load('{}')",
    "from dofbench.kernels import load as kernel\ndef wanted(x): return kernel('{}', 'cpu')(x)",
    "from dofbench import kernels\ndef wanted(): return kernels.load('{}', backend='cpu')",
    "import dofbench.kernels\ndef wanted(): return dofbench.kernels.load('{}')",
    "def wanted():\n    from dofbench.kernels import load\n    return load('{}')",
    "from dofbench.kernels import load\nKERNEL = load('{}')\ndef wanted(): return KERNEL",
]
NOT_NAMED = [
    "from dofbench.kernels import load\ndef wanted(op='{}'): return load(op)",
    "from dofbench.kernels import load\ndef wanted(): return [load(op) for op in ('{}',)]",
    "from dofbench.kernels import load\ndef wanted(): return load(*['{}'])",
    "from dofbench.kernels import load\ndef wanted(): return load('{}' + '')",
    "from dofbench.kernels import load\ndef wanted(): return load('{}_or_another')",
    "from dofbench.kernels import load\ndef wanted(): return partial(load, '{}')",
    "from dofbench.kernels import load\ndef wanted(op): return load('{}'), load(op)",
    "from dofbench import kernels\ndef wanted(): return vars(kernels)['load']('{}')",
]


def kernels_that_count(tree, entry: str) -> set[str]:
    """The kernels of which a change is a change of the entry: of a backend, of its part, of the definition."""
    before = tree({**KERNELS, "low/entry.py": entry})
    found = set()
    for name, text in KERNELS.items():
        for old in ("HALF = 2", "TWICE = 2", "ZERO = 2"):
            if old in text and tree({**KERNELS, "low/entry.py": entry, name: text.replace(old, old + "0")}) != before:
                found.add(old.split()[0])
    return found


@pytest.mark.parametrize("entry", NAMED)
def test_a_kernel_that_is_called_by_name_counts_alone(tree, entry: str) -> None:
    assert kernels_that_count(tree, entry.format("blur")) == {"HALF", "TWICE"}
    assert kernels_that_count(tree, entry.format("tone")) == {"ZERO"}


@pytest.mark.parametrize("entry", NOT_NAMED)
def test_every_kernel_counts_where_none_is_named(tree, entry: str) -> None:
    for op in ("blur", "tone"):
        assert kernels_that_count(tree, entry.format(op)) == {"HALF", "TWICE", "ZERO"}


def test_what_the_bridge_itself_does_counts_for_a_named_kernel_too(tree) -> None:
    entry = {**KERNELS, "low/entry.py": "from dofbench.kernels import others\ndef wanted(): return others('tone')"}
    before = tree(entry)
    assert tree({**entry, "kernels/__init__.py": BRIDGE.replace("found(op)", "found(op + 1)")}) != before
    assert tree({**entry, "low/files.py": "def found(op): return 2"}) != before
    assert tree({**entry, "kernels/__init__.py": BRIDGE.replace("return _module(op,", "return _module(2,")}) == before


def test_sources_that_were_read_before_see_what_changed_since(tmp_path: Path) -> None:
    """The same object, as one process asks again and again: a text, a module that comes, and one that goes."""
    package = tmp_path / "dofbench"
    (package / "parts").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "entry.py").write_text("def wanted(name): return import_module(f'dofbench.parts.{name}'), other()\n")
    (package / "parts" / "one.py").write_text("ONE = 1")
    beside = Sources({"dofbench": package})
    sources = Sources({"method": tmp_path / "method"}, beside=beside)

    def digest() -> str:
        found = closure_digest(["dofbench.entry:wanted"], sources)
        assert found == closure_digest(["dofbench.entry:wanted"], sources)
        return found

    found = [digest()]
    (package / "parts" / "one.py").write_text("ONE = 100")
    found.append(digest())
    (package / "parts" / "two.py").write_text("TWO = 2")
    found.append(digest())
    (package / "parts" / "one.py").unlink()
    found.append(digest())
    assert len(set(found)) == 4


def test_a_method_may_use_what_is_beside_it_and_not_the_other_way_round(tmp_path: Path) -> None:
    for name, text in {
        "dofbench/__init__.py": "",
        "dofbench/low.py": "FACTOR = 2",
        "method/trainer.py": "from dofbench.low import FACTOR\ndef fit(): return FACTOR",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    beside = Sources({"dofbench": tmp_path / "dofbench"})
    sources = Sources({"method": tmp_path / "method"}, beside=beside)
    assert ("dofbench.low", "FACTOR") in closure(["method."], sources)
    assert closure(["dofbench.low"], sources).keys() == closure(["dofbench.low"], beside).keys()
    before = closure_digest(["method."], sources)
    (tmp_path / "dofbench" / "low.py").write_text("FACTOR = 200")
    assert closure_digest(["method."], sources) != before


def test_a_file_may_have_another_name_and_place(tree) -> None:
    before = tree({"low/entry.py": USES[2], "low/constants.py": "FACTOR = 2"})
    moved = (
        USES[2]
        .replace("dofbench.low import constants", "dofbench.high import numbers")
        .replace("constants.", "numbers.")
    )
    assert tree({"low/entry.py": moved, "high/numbers.py": "FACTOR = 2"}) == before


def test_two_names_that_change_places_are_seen(tree) -> None:
    """The same definitions are reached, but their arithmetic is different."""
    code = "from dofbench.low.a import {} as p\nfrom dofbench.low.a import {} as q\ndef wanted(x): return p(x) - q(x)"
    twice = {"low/a.py": "def f(x): return x\ndef g(x): return 2 * x"}
    before = tree({"low/entry.py": code.format("f", "g"), **twice})
    assert tree({"low/entry.py": code.format("g", "f"), **twice}) != before


def test_a_name_that_is_not_there_is_said() -> None:
    with pytest.raises(LookupError, match="dofbench.core.lens:nothing"):
        closure_digest(["dofbench.core.lens:nothing"])


# ---- the real tree ----


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package and the content beside it, to be edited."""
    root = tmp_path_factory.mktemp("tree")
    left_out = shutil.ignore_patterns("__pycache__", "_content")
    shutil.copytree(own_sources().roots["dofbench"], root / "dofbench", ignore=left_out)
    for name in ("kernels", "methods"):
        shutil.copytree(content_folder(name), root / name, ignore=left_out)
    return root


@pytest.fixture
def versions(copied: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that gives the code version of everything that is kept: a result, each stability group, a kernel."""
    sources = {"dofbench": copied / "dofbench", "dofbench.kernels": copied / "kernels"}

    def now() -> dict[str, str]:
        fresh = Sources(sources)
        on_a_cpu = Sources(sources, left_out=import_closure._GPU_ALONE)
        monkeypatch.setattr(provenance, "own_sources", lambda device: on_a_cpu if device == "cpu" else fresh)
        monkeypatch.setattr(unfinished, "own_sources", lambda: fresh)
        monkeypatch.setattr(unfinished, "method_folders", lambda: [copied / "methods"])
        return {
            "result": provenance.code_version(copied / "methods" / "dofgaussian", "cpu"),
            "result on a GPU": provenance.code_version(copied / "methods" / "dofgaussian", "cuda"),
            **{group: unfinished.code_of(group) for group in GROUPS},
            "renderer": closure_digest(RENDERER_SCORES, fresh),
            "scatter": closure_digest(["dofbench.kernels.scatter.cpu_linear:_spread"], fresh),
        }

    return now


def edited(file: Path, old: str, new: str):
    """Change the first `old` in a file for the time of a `with`."""

    class Edit:
        def __enter__(self) -> None:
            self.text = file.read_text()
            assert old in self.text, f"{old!r} isn't in {file.name} any more: choose another line to change"
            file.write_text(self.text.replace(old, new, 1))

        def __exit__(self, *_: object) -> None:
            file.write_text(self.text)

    return Edit()


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("dofbench/reporting/markdown_writer.py", "|", "||"),
        ("dofbench/cli.py", "Help on one command", "Help"),
        ("methods/dofgaussian/ablations.toml", "[", "# a remark\n["),
        ("dofbench/optics/defocus.py", '"""', '"""In other words: '),
    ],
)
def test_what_scores_nothing_outdates_nothing(copied, versions, name: str, old: str, new: str) -> None:
    before = versions()
    with edited(copied / name, old, new):
        assert versions() == before


def test_a_template_outdates_what_looks_at_its_bytes_alone(copied, versions) -> None:
    template = "dofbench/synthesis/dataset_readme.py", "## Files", "## All files"
    assert changed_by(copied, versions, *template) == {"datasets"}  # two builds must be the same bytes


def changed_by(copied, versions, name: str, old: str, new: str) -> set[str]:
    before = versions()
    with edited(copied / name, old, new):
        after = versions()
    return {what for what in before if after[what] != before[what]}


def test_arithmetic_outdates_what_used_it(copied, versions) -> None:
    toe = changed_by(copied, versions, "dofbench/optics/tone.py", "TOE = 0.5", "TOE = 0.6")
    assert {"result", "light", "training", "renderer"} <= toe and "scatter" not in toe
    area = changed_by(copied, versions, "dofbench/core/lens.py", "AREA_EPSILON = ", "AREA_EPSILON = 1 + ")
    assert {"result", "scatter", "renderer"} <= area
    metric = changed_by(copied, versions, "dofbench/metrics/psnr.py", "-10.0 *", "-11.0 *")
    assert "result" in metric and "scatter" not in metric
    density = changed_by(
        copied, versions, "dofbench/gaussians/density.py", "_RESET_OPACITY = 0.01", "_RESET_OPACITY = 0.02"
    )
    assert {"result", "training"} <= density and not {"scatter", "renderer", "light"} & density
    rasteriser = changed_by(copied, versions, "kernels/rasterize/cpu_layout.py", "float32(0.99)", "float32(0.98)")
    assert {"result", "training", "gaussians"} <= rasteriser and not {"renderer", "scatter"} & rasteriser
    blur = changed_by(copied, versions, "kernels/scatter/cpu_linear.py", "float32(126.0)", "float32(125.0)")
    assert {"result", "training", "light", "renderer", "scatter"} <= blur
    case = changed_by(copied, versions, "dofbench/stability/files_cases.py", "LEVEL = 1 / 255", "LEVEL = 2 / 255")
    assert case == {"files"}


def test_a_backend_that_only_a_gpu_has_outdates_nothing_that_a_cpu_made(copied, versions) -> None:
    kernel = changed_by(copied, versions, "kernels/tone/gpu_power.py", "x * slope", "x * slope * slope")
    assert "result on a GPU" in kernel and "result" not in kernel
    assert "result" not in changed_by(copied, versions, "kernels/tone/gpu.py", "_BLOCK = 1024", "_BLOCK = 512")


def test_a_kernel_is_compiled_again_after_a_constant_in_another_package_changed(copied, tmp_path) -> None:
    program = (
        "import torch\nfrom dofbench.kernels import load\nfrom dofbench.compute import kernel_cache\n"
        "load('tone')(torch.rand(9), 2.2, 0.01, 0.01**1.2)\nprint(kernel_cache.compiled())"
    )
    environment = {**os.environ, "PYTHONPATH": str(copied), "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONSAFEPATH": "1"}

    def compiled() -> int:
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
        return int(done.stdout)

    first = compiled()
    assert first > 0
    assert compiled() == 0
    with edited(copied / "dofbench/compute/simd_functions.py", "np.sqrt(0.5)", "np.sqrt(0.51)"):
        assert compiled() > 0
    # Operators are reached by no name: to import the module is enough to have them.
    with edited(copied / "dofbench/compute/simd.py", "builder.fdiv(a, b)", "builder.fdiv(b, a)"):
        assert compiled() > 0


def test_reaching_is_not_reaching_everything() -> None:
    """A result doesn't depend on how datasets are made, reported or drawn from recipes."""
    reached = {module.split(".")[1] for module, name in closure(provenance._MAKES_SCORES) if name and "." in module}
    assert not reached & {"synthesis", "procedural", "reporting", "validation", "stability", "commands", "cli"}
    assert {"gaussians"} & reached == set()  # methods are reached by the method's own folder
    assert {"scoring", "metrics", "dataset", "core"} <= reached
