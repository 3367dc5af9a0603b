"""Ctrl-C while the program is still importing, and errors that stand for a lack of memory."""

from __future__ import annotations

import errno
import subprocess
import sys

import pytest

from dofbench.core.errors import InputError, Status
from dofbench.running.failures import classify

PROGRAM = """
import os, signal, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "MODULE":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
from dofbench.cli.app import console
sys.argv = ['dofbench', 'validate-renderer']
console()
"""


@pytest.mark.parametrize("module", ["tyro", "dofbench.evaluation.renderer.validation_options"])
def test_an_interruption_while_importing_is_one_line(module: str) -> None:
    program = PROGRAM.replace("MODULE", module)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "dofbench: interrupted; rerun the same command to resume\n")


def _chained() -> Exception:
    try:
        try:
            raise MemoryError
        except MemoryError:
            raise RuntimeError("loading failed")  # noqa: B904 - as code that names no cause does
    except RuntimeError as error:
        return error


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
        RuntimeError("std::bad_alloc"),
        RuntimeError("LLVM ERROR: out of memory"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        ImportError("libx.so: failed to map segment from shared object"),
        _chained(),
    ],
)
def test_a_lack_of_memory_is_told_by_whatever_fails_first(error: Exception) -> None:
    assert classify(error)[0] is Status.OUT_OF_MEMORY


@pytest.mark.parametrize("error", [RuntimeError("broken"), InputError("a", "out of memory", "b"), KeyError("x")])
def test_other_errors_are_crashes(error: Exception) -> None:
    assert classify(error)[0] is Status.CRASHED
