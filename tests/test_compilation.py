"""Kernels compiled by several processes: each op once, what isn't needed not begun, and this process as it was."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from called import called

from dofbench.runtime import compilation, kernel_cache

# A process that writes down what it is asked for; for "slow" it waits until there is the file "go", at "bad" it dies.
COMPILER = """
import pathlib, sys, time
done = pathlib.Path(sys.argv[1])
for op in sys.stdin:
    if op.strip() == "bad":
        sys.exit(1)
    with done.open("a") as stream:
        stream.write(op)
    while op.strip() == "slow" and not done.with_name("go").exists():
        time.sleep(0.01)
    print(2, flush=True)
"""


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The ops that other processes have compiled, by a look at them."""
    done = tmp_path / "done"
    command = [sys.executable, "-c", COMPILER, str(done)]
    pipe = subprocess.PIPE
    monkeypatch.setattr(compilation, "_compiler", lambda: subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True))
    monkeypatch.setattr(compilation, "_ahead", None)
    return lambda: done.read_text().split() if done.exists() else []


@pytest.fixture
def here(elsewhere: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The ops that this process has compiled."""
    done: list[str] = []
    monkeypatch.setattr(compilation, "warm_up", lambda op, device="cpu": done.append(op))
    monkeypatch.setattr(compilation, "is_warm", lambda op: op == "warm" or op in (*done, *elsewhere()))
    return done


@pytest.mark.parametrize("threads", ["1", "2", "9"])
def test_every_op_is_compiled_once(
    threads: str, here: list[str], elsewhere: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    before = kernel_cache.compiled()
    compilation.compile_all(["a", "b", "warm", "c", "d", "e", "f"])
    assert sorted([*here, *elsewhere()]) == ["a", "b", "c", "d", "e", "f"]
    assert kernel_cache.compiled() - before == 2 * len(elsewhere())
    assert threads != "1" or not elsewhere()


def test_what_is_not_needed_is_not_begun(
    here: list[str], elsewhere: Callable[[], list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    compilation.compile_ahead(["slow", "b", "c", "last"])
    while not elsewhere():
        time.sleep(0.01)

    def compile_here(op: str) -> None:
        here.append(op)
        (tmp_path / "go").touch()

    monkeypatch.setattr(compilation, "warm_up", compile_here)
    compilation.compile_all(["slow", "last"])
    assert (elsewhere(), here) == (["slow"], ["last"])


def test_after_a_process_that_died_this_one_compiles(here: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    compilation.compile_ahead(["bad", "a"])
    compilation.compile_all(["bad", "a"])
    assert sorted(here) == ["a", "bad"]


@pytest.mark.parametrize("enabled", [True, False])
def test_the_garbage_collector_rests_and_is_then_as_before(
    enabled: bool, here: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, during = gc.isenabled(), []
    monkeypatch.setattr(compilation, "warm_up", lambda op: during.append(gc.isenabled()))
    try:
        (gc.enable if enabled else gc.disable)()
        compilation.compile_all(["a"])
        assert during == [False] and gc.isenabled() is enabled
    finally:
        (gc.enable if before else gc.disable)()


PROGRAM = """
from dofbench.runtime import compilation, kernel_cache
from dofbench.runtime.ops import is_warm
ops = ["colours", "tone"]
compilation.compile_ahead(ops)
compilation.compile_all(ops)
print(all(map(is_warm, ops)), kernel_cache.compiled())
"""


def _compiled(cache: Path) -> str:
    done = called([sys.executable, "-c", PROGRAM], NUMBA_CACHE_DIR=str(cache), NUMBA_NUM_THREADS="2")
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_real_kernels_come_back_from_other_processes(tmp_path: Path) -> None:
    assert _compiled(tmp_path) == "True 4"  # a forward and a backward pass each
    assert _compiled(tmp_path) == "True 0"
    assert len(list(tmp_path.rglob("*.nbc"))) == 4
