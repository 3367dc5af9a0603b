"""Memory that a training frees stays with its process, where the C library can be told to keep it."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

from dofbench.runtime.freed_memory import keep_freed_memory

# Without huge pages: whether an array gets some depends on what else the machine does, and one counts as one fault.
PAGES = """
import ctypes, resource, sys
ctypes.CDLL(None).prctl(41, 1, 0, 0, 0)  # PR_SET_THP_DISABLE
import numpy as np
from dofbench.runtime.freed_memory import keep_freed_memory

def faults(rounds):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(rounds):
        np.ones(25_000_000)  # 200 MB
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

if sys.argv[1] == "keep":
    assert keep_freed_memory()
print(faults(1), faults(5))
"""


def pages(what: str) -> tuple[int, int]:
    """Pages that the system gave for one array, and for five more, each dropped before the next."""
    found = subprocess.run([sys.executable, "-c", PAGES, what], check=True, capture_output=True, text=True)
    first, more = map(int, found.stdout.split())
    return first, more


@pytest.mark.skipif(
    not (sys.platform.startswith("linux") and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")),
    reason="the C library isn't glibc",
)
def test_freed_memory_is_used_again() -> None:
    first, more = pages("keep")
    assert more < first / 10
    first, more = pages("give back")
    assert more > first  # what the settings change


def test_other_systems_have_no_such_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not keep_freed_memory()
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    assert not keep_freed_memory()
