"""A backend that declares that its bits repeat is held to it: other processes, other numbers of threads, same bits."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import kernel_bits
import pytest
from called import called

from dofbench.runtime.ops import backend_of, ops

PROGRAM = Path(kernel_bits.__file__)
# torch takes the powers of a chunk's last numbers another way than the rest, and each thread has a chunk.
CHANGES = "tone reference cpu float32"
# These promise nothing: sums of torch are split among its threads.
NO_PROMISE = {(op, "reference") for op in ops()}


@pytest.fixture(scope="module")
def asked() -> list[str]:
    calls = list(kernel_bits.every_call())
    return [" ".join(call) for call in calls if backend_of(*call[:2]).bits_repeat]


@pytest.fixture(scope="module")
def runs(asked: list[str]) -> list[dict[str, str]]:
    """Call -> digest, in a process of one thread and in another of three."""
    found = []
    for threads in ("1", "3"):
        command = [sys.executable, str(PROGRAM), *asked, CHANGES]
        done = called(command, OMP_NUM_THREADS=threads, NUMBA_NUM_THREADS=threads)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    return found


def test_what_declares_that_its_bits_repeat_repeats_them(asked: list[str], runs: list[dict[str, str]]) -> None:
    assert [call for call in asked if len({run[call] for run in runs}) > 1] == []


def test_a_difference_between_threads_would_be_seen(runs: list[dict[str, str]]) -> None:
    assert runs[0][CHANGES] != runs[1][CHANGES]


def test_who_promises_nothing_is_known(asked: list[str]) -> None:
    """So that a backend isn't left out of the comparison by declaring nothing."""
    silent = {call[:2] for call in kernel_bits.every_call() if not backend_of(*call[:2]).bits_repeat}
    assert silent == NO_PROMISE


def test_every_op_has_its_calls() -> None:
    assert set(kernel_bits.CALLS) == set(ops())
