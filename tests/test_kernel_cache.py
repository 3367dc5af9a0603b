"""A damaged or unwritable cache of machine code: compiled again, with the same result."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROGRAM = """
import os

from numba import njit
from numba.core import caching
from dofbench.runtime import kernel_cache

def ensure(self):
    if self.get_cache_path().startswith(os.environ.get("READ_ONLY", "none")):
        raise PermissionError("read-only")
    usual(self)

usual, caching._CacheLocator.ensure_cache_path = caching._CacheLocator.ensure_cache_path, ensure

@kernel_cache.cached
@njit
def twice(x):
    return 2 * x

number = {"int": int, "float": float, "complex": complex}[os.environ.get("KIND", "int")](21)
print(twice(number), kernel_cache.compiled(), kernel_cache.is_compiled(twice))
"""


def _start(folder: Path, cache: Path, **variables: str) -> subprocess.Popen[str]:
    (folder / "kernel_here.py").write_text(PROGRAM)
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache), "PYTHONSAFEPATH": "1", **variables}
    command = [sys.executable, "-c", "import kernel_here"]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder)


def _ran(folder: Path, cache: Path, **variables: str) -> str:
    process = _start(folder, cache, **variables)
    out, _ = process.communicate()
    assert process.returncode == 0
    return out.strip()


def _flip(file: Path, at: int) -> None:
    content = bytearray(file.read_bytes())
    content[at] ^= 8
    file.write_bytes(bytes(content))


def _folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


DAMAGES: dict[str, Callable[[Path], None]] = {
    "empty": lambda file: file.write_bytes(b""),
    "a bit": lambda file: _flip(file, file.stat().st_size // 2),
    "folder": _folder,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(the program's folder, a cache that it has filled)."""
    folder, cache = tmp_path_factory.mktemp("program"), tmp_path_factory.mktemp("cache")
    assert _ran(folder, cache) == "42 1 True" and _ran(folder, cache) == "42 0 True"
    return folder, cache


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cache_is_compiled_again(whole: tuple[Path, Path], tmp_path: Path, damage: str) -> None:
    folder, cache = whole
    copy = tmp_path / "cache"
    shutil.copytree(cache, copy)
    [file] = copy.rglob("*.nbc")
    DAMAGES[damage](file)
    assert _ran(folder, copy).startswith("42 1")
    if damage == "a bit":
        assert _ran(folder, copy) == "42 0 True"


@pytest.mark.slow
def test_a_change_of_a_module_next_to_it_compiles_it_again(whole: tuple[Path, Path], tmp_path: Path) -> None:
    folder, cache = tmp_path / "program", tmp_path / "cache"
    shutil.copytree(whole[0], folder)
    (folder / "constants.py").write_text("FACTOR = 2\n")
    assert _ran(folder, cache).startswith("42 1") and _ran(folder, cache).startswith("42 0")
    (folder / "constants.py").write_text("FACTOR = 3\n")
    assert _ran(folder, cache).startswith("42 1")


@pytest.mark.parametrize("place", ["/dev/null/cache"])
def test_without_a_writable_cache_it_is_compiled_in_memory(whole: tuple[Path, Path], place: str) -> None:
    assert _ran(whole[0], Path(place)).startswith("42")


def test_a_cache_that_is_read_only_is_read(whole: tuple[Path, Path], tmp_path: Path) -> None:
    folder, cache = whole
    home = {"READ_ONLY": str(cache), "XDG_CACHE_HOME": str(tmp_path)}
    assert _ran(folder, cache, **home) == "42 0 True"
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    assert _ran(folder, cache, KIND="float", **home).startswith("42.0 1")  # new types are stored elsewhere
    assert _ran(folder, cache, KIND="float", **home).startswith("42.0 0")


def test_nothing_that_can_be_written_but_code_to_read(whole: tuple[Path, Path]) -> None:
    assert _ran(*whole, READ_ONLY="/") == "42 0 True"


def test_code_for_another_processor_is_not_taken(whole: tuple[Path, Path], tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    shutil.copytree(whole[1], cache)
    other = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}
    assert _ran(whole[0], cache, **other) == "42 1 True"
    assert _ran(whole[0], cache, **other) == _ran(whole[0], cache) == "42 0 True"


@pytest.mark.slow
def test_processes_that_compile_other_types_at_once_lose_nothing(whole: tuple[Path, Path], tmp_path: Path) -> None:
    results = {"int": "42", "float": "42.0", "complex": "(42+0j)"}
    started = [(_start(whole[0], tmp_path, KIND=kind), result) for kind, result in results.items()]
    assert [process.communicate()[0].strip() for process, _ in started] == [f"{result} 1 True" for _, result in started]
    assert all(_ran(whole[0], tmp_path, KIND=kind) == f"{result} 0 True" for kind, result in results.items())
