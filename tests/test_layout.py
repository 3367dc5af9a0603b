"""Checks of the rules in docs/architecture.md: content folders and how they are reached, docstrings, declared
packages."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from itertools import chain
from pathlib import Path

import pytest

from dofbench import kernels
from dofbench.core.content import FOLDERS, content_folder

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
TOP_FOLDERS = tuple(dict.fromkeys(folder.partition("/")[0] for folder in FOLDERS))
CODE = ("dofbench", "kernels", "methods", "datasets")
LARGEST_FILE = 3_000_000  # bytes; the repository holds code, not data


def sources(*folders: str) -> list[Path]:
    """The Python files under folders of the repository."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def tracked_files() -> list[Path]:
    """What the repository holds or would hold after `git add`."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout, so which files belong to the repository is unknown")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def imports(path: Path) -> Iterator[tuple[str, list[str]]]:
    """(module, imported names) of every static import in a file; a relative module keeps its leading dots."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, []) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or ""), [alias.name for alias in node.names]


# ---- content folders ----


@pytest.mark.parametrize("name", TOP_FOLDERS)
def test_top_folder_is_no_package(name: str) -> None:
    assert not (ROOT / name / "__init__.py").exists()


def test_content_folders_do_not_shadow_packages_of_the_same_name(tmp_path: Path) -> None:
    """A registry package called `datasets` must win, wherever the checkout stands on the import path."""
    for name in TOP_FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    script = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.path.append({str(tmp_path)!r}); import dofbench.kernels\n"
        f"for name in {TOP_FOLDERS!r}: assert __import__(name).__file__.startswith({str(tmp_path)!r}), name"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_every_module_of_an_op_is_a_backend_or_part_of_one() -> None:
    folders = {path.name for path in content_folder("kernels").iterdir() if any(path.glob("*.py"))}
    assert folders == set(kernels.ops()), "a folder without reference.py, the definition, is no op"
    for op in kernels.ops():
        for file in (content_folder("kernels") / op).glob("*.py"):
            assert file.stem == "__init__" or file.stem.split("_")[0] in kernels.backends(op), file


def test_every_method_folder_says_what_it_is() -> None:
    folders = [path for path in content_folder("methods").iterdir() if path.is_dir() and path.name != "__pycache__"]
    assert folders
    for folder in folders:
        assert (folder / "method.toml").is_file(), folder.name


def test_wheel_maps_every_content_folder() -> None:
    build = PROJECT["tool"]["hatch"]["build"]
    mapped = build["targets"]["wheel"]["sources"]
    assert set(mapped) == set(build["only-include"])
    assert mapped.pop("dofbench") == "dofbench"
    assert mapped == {name: f"dofbench/_content/{name}" for name in FOLDERS}


# ---- the bridge ----


def crossings(path: Path) -> list[str]:
    """Static imports in a file that reach a kernel or a method by name instead of by id."""
    inside = path.relative_to(ROOT).parts
    found = []
    for module, names in imports(path):
        level = len(module) - len(module.lstrip("."))
        if level:  # a relative import must stay in the top-level folder that the file is in
            if level >= len(inside):
                found.append(module)
            continue
        parts = module.split(".")
        targets = [parts] if not names else [[*parts, name] for name in names]
        for target in targets:
            if target[:2] == ["dofbench", "methods"] and len(target) > 2:
                found.append(".".join(target))
            if target[:2] == ["dofbench", "kernels"] and len(target) > 2 and target[2] not in vars(kernels):
                found.append(".".join(target))
            if target[:3] in (["dofbench", "kernels", op] for op in kernels.ops()):
                found.append(".".join(target))
            if target[0] in TOP_FOLDERS:
                found.append(".".join(target))
    return sorted(set(found))


def test_no_static_import_crosses_the_bridge() -> None:
    assert {str(path): found for path in sources(*CODE) if (found := crossings(path))} == {}


def test_a_crossing_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    path = tmp_path / "dofbench" / "a.py"
    path.parent.mkdir()
    path.write_text("import dofbench.kernels.scatter.cpu\nfrom dofbench.kernels import load, ssim\nfrom .. import b\n")
    assert crossings(path) == ["..", "dofbench.kernels.scatter.cpu", "dofbench.kernels.ssim"]


# ---- documentation ----


def undocumented(path: Path) -> Iterator[str]:
    """Names of the module's public functions, classes and methods without a docstring."""
    tree = ast.parse(path.read_text())
    if tree.body and not ast.get_docstring(tree):
        yield "the module"
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        if not ast.get_docstring(node):
            yield node.name
        if isinstance(node, ast.ClassDef):
            for member in node.body:
                public = isinstance(member, ast.FunctionDef) and not member.name.startswith("_")
                if public and not ast.get_docstring(member):
                    yield f"{node.name}.{member.name}"


def test_public_names_have_docstrings() -> None:
    assert {str(path): found for path in sources(*CODE) if (found := list(undocumented(path)))} == {}


# ---- packages ----


def declared(requirements: list[str]) -> set[str]:
    """Normalised names of requirement strings."""
    return {re.split(r"[^A-Za-z0-9._-]", entry, maxsplit=1)[0].lower().replace("_", "-") for entry in requirements}


def test_every_imported_package_is_declared() -> None:
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    runtime = declared(project["dependencies"] + extras["render"] + extras["photographs"] + extras["gpu"])
    allowed = {**dict.fromkeys(CODE, runtime), "tests": runtime | declared(extras["test"])}
    providers = packages_distributions()
    own = {"dofbench", *(path.stem for path in (ROOT / "tests").glob("*.py"))}
    for folder, names in allowed.items():
        for path in sources(folder):
            for module, _ in imports(path):
                top = module.split(".")[0]
                beside = (path.parent / top).is_dir() or (path.parent / f"{top}.py").is_file()  # a script's own
                if not top or top in sys.stdlib_module_names or top in own or beside:
                    continue
                found = {name.lower().replace("_", "-") for name in providers.get(top, [top])}
                assert found & names, f"{path.relative_to(ROOT)} imports {top}, which pyproject.toml doesn't declare"


def pins(file: str) -> dict[str, str]:
    """Versions by normalised name, from the lines of a file of the repository that name a package."""
    lines = re.findall(r"^([A-Za-z0-9._-]+)==([0-9][A-Za-z0-9.]*)", (ROOT / file).read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in lines}


def test_constraints_pin_every_declared_package_exactly() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*", line) for line in lines)
    pinned = pins("constraints.txt")
    assert len(pinned) == len(lines)
    project = PROJECT["project"]
    extras = chain.from_iterable(project["optional-dependencies"].values())
    assert declared([*project["dependencies"], *extras, *PROJECT["build-system"]["requires"]]) <= set(pinned)


def test_every_list_of_versions_has_the_same() -> None:
    """That of the build, as pip's constraints don't reach it, and the one with hashes."""
    pinned = pins("constraints.txt")
    assert PROJECT["build-system"]["requires"] == [f"hatchling=={pinned['hatchling']}"]
    hashed = pins("requirements-hashed.txt")
    assert pinned.items() <= hashed.items()
    assert set(hashed) - set(pinned) <= {"pywin32-ctypes"}  # Windows only


# ---- files ----


def test_no_large_file() -> None:
    assert [str(path) for path in tracked_files() if path.stat().st_size > LARGEST_FILE] == []


def test_nothing_is_left_for_later() -> None:
    words = re.compile(rb"\b(" + b"|".join([b"TO" + b"DO", b"FIX" + b"ME", b"XX" + b"X", b"HA" + b"CK"]) + rb")\b")
    found = []
    for path in tracked_files():
        content = path.read_bytes()
        if b"\0" not in content and words.search(content):  # binary files contain any three letters by chance
            found.append(str(path))
    assert found == []


def test_test_folders_are_no_packages() -> None:
    assert not list((ROOT / "tests").rglob("__init__.py"))
