"""Hundreds of damaged inputs: each is read, or refused in one line, in bounded time and memory.

`tests/damage_trials.py` tries them in processes of their own; a failure names the seed, which gives the input again.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from damage_trials import tried
from damaged_files import KINDS

FEW, MANY = 20, 200


def _failures(folder: Path, kind: str, first: int, count: int) -> list[str]:
    found = list(tried(folder, kind, first, count))
    assert len(found) == count
    assert any(one.verdict == "refused" for one in found)
    bad = [one for one in found if one.verdict not in ("read", "refused")]
    return [f"{kind} {one.seed}: {one.done}: {one.verdict}\n{one.message}" for one in bad]


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    assert _failures(tmp_path, kind, 0, FEW) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files(tmp_path: Path, kind: str) -> None:
    assert _failures(tmp_path, kind, FEW, MANY) == []
