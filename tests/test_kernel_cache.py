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
from numba import njit
from dofbench.runtime import kernel_cache

@kernel_cache.cached
@njit
def twice(x):
    return 2 * x

print(twice(21), kernel_cache.compiled(), kernel_cache.is_compiled(twice))
"""


def _ran(folder: Path, cache: Path) -> str:
    (folder / "kernel_here.py").write_text(PROGRAM)
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", "import kernel_here"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


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
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cache_is_compiled_again(whole: tuple[Path, Path], tmp_path: Path, damage: str, suffix: str) -> None:
    folder, cache = whole
    copy = tmp_path / "cache"
    shutil.copytree(cache, copy)
    [file] = copy.rglob(f"*{suffix}")
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
