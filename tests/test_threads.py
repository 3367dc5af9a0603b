"""Thread counts: the user's setting, else the container's quota, else the machine's cores."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dofbench.runtime.threads import available_cores, configure_processor, configure_threads


@pytest.fixture
def eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)


@pytest.mark.parametrize(
    ("limit", "cores"),
    [("max 100000", 8), ("200000 100000", 2), ("150000 100000", 2), ("10000 100000", 1), ("9900000 100000", 8)],
)
def test_quota_of_a_container_counts(eight_cores: None, tmp_path: Path, limit: str, cores: int) -> None:
    (tmp_path / "cpu.max").write_text(limit + "\n")
    assert available_cores(tmp_path) == cores


def test_quota_of_the_older_interface_counts(eight_cores: None, tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    for quota, cores in (("300000", 3), ("-1", 8)):
        (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text(quota + "\n")
        assert available_cores(tmp_path) == cores


def test_no_quota_known_means_all_cores(eight_cores: None, tmp_path: Path) -> None:
    assert available_cores(tmp_path) == 8


def test_the_users_word_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3,2")
    monkeypatch.delenv("NUMBA_NUM_THREADS")
    configure_threads()
    assert (os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"]) == ("3,2", "3")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    configure_threads()
    assert os.environ["NUMBA_NUM_THREADS"] == "1"


@pytest.mark.parametrize(
    ("named", "features", "expected"),
    [("x86-64-v3", None, ""), ("x86-64-v3", "+avx512f", "+avx512f"), (None, None, None), ("", None, None)],
)
def test_a_named_processor_has_no_features_of_this_machine(
    named: str | None, features: str | None, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("NUMBA_CPU_NAME", named), ("NUMBA_CPU_FEATURES", features)):
        monkeypatch.setenv(name, value or "")  # so that it is as before afterwards, whatever is set below
        if value is None:
            monkeypatch.delenv(name)
    configure_processor()
    assert os.environ.get("NUMBA_CPU_FEATURES") == expected
