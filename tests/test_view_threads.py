"""Several views at a time: the same results, errors and files as one at a time, in bounded memory."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dofbench.runtime import view_threads
from dofbench.runtime.memory import free_memory_mb, machine_memory_mb
from dofbench.runtime.view_threads import over_views, views_at_once

MEGAPIXEL = 1_000_000


def threads_left() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("view-")]


@pytest.fixture(autouse=True)
def _no_thread_is_left() -> Iterator[None]:
    yield
    assert threads_left() == []


def outcome(results: Iterator[int]) -> tuple[list[int], str]:
    """What was yielded, and the error that ended it."""
    taken: list[int] = []
    try:
        taken.extend(results)
    except ValueError as error:
        return taken, str(error)
    return taken, ""


@given(st.lists(st.integers(0, 3), max_size=12), st.integers(1, 5))
def test_results_and_the_first_error_are_those_of_one_at_a_time(views, at_once):
    def work(view: int) -> int:
        time.sleep(0.0002 * (3 - view))  # later views end first
        if view == 0:
            raise ValueError("view 0")
        return 10 * view

    expected = [10 * view for view in views]
    if 0 in views:
        expected = expected[: views.index(0)]
    taken, error = outcome(over_views(work, views, at_once))
    assert taken == expected
    assert bool(error) is (0 in views)


def test_the_error_is_that_of_the_earliest_view_even_if_a_later_one_fails_sooner():
    def work(view: int) -> int:
        time.sleep(0.05 if view == 1 else 0.0)
        if view in (1, 2):
            raise ValueError(f"view {view}")
        return view

    assert outcome(over_views(work, range(6), 3)) == ([0], "view 1")


def test_no_more_views_at_a_time_than_asked_and_few_results_wait():
    at_work, most, begun, lock = 0, 0, 0, threading.Lock()

    def work(view: int) -> int:
        nonlocal at_work, most, begun
        with lock:
            at_work, begun = at_work + 1, begun + 1
            most = max(most, at_work)
        time.sleep(0.002)
        with lock:
            at_work -= 1
        return view

    results = over_views(work, range(100), 3)
    assert list(islice(results, 5)) == list(range(5))
    time.sleep(0.1)
    assert begun < 20
    assert list(results) == list(range(5, 100))
    assert most == 3


@pytest.mark.parametrize("how", ["closed", "failed"])
def test_views_at_work_are_finished_and_no_further_ones_are_started(how):
    busy, finished = threading.Event(), []

    def work(view: int) -> int:
        if view == 0:
            busy.wait(10)
            if how == "failed":
                raise ValueError("view 0")
            return 0
        busy.set()
        time.sleep(0.05)
        finished.append(view)
        return view

    results = over_views(work, range(100), 2)
    if how == "failed":
        assert outcome(results) == ([], "view 0")
    else:
        assert next(results) == 0
        results.close()
    assert finished and sorted(finished) == list(range(1, 1 + len(finished)))
    assert len(finished) < 20
    assert threads_left() == []


def test_one_view_at_a_time_needs_no_thread():
    assert set(over_views(lambda _: threading.current_thread(), range(3), 1)) == {threading.current_thread()}
    assert set(over_views(lambda _: threading.current_thread(), range(1), 4)) == {threading.current_thread()}


def test_views_at_a_time_follow_threads_size_and_memory(monkeypatch):
    monkeypatch.setattr(view_threads, "available_cores", lambda: 4)
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    each = view_threads.BYTES_PER_PIXEL * 12 * MEGAPIXEL / 1e6
    assert views_at_once(12 * MEGAPIXEL, 100 * each) == 4
    assert views_at_once(12 * MEGAPIXEL, 3.5 * each) == 3
    assert views_at_once(12 * MEGAPIXEL, 0.0) == 1
    assert views_at_once(MEGAPIXEL, 3.5 * each) == 4
    # A process that has half of the cores, as one of two datasets made at a time, has half of the memory.
    monkeypatch.setenv("OMP_NUM_THREADS", "2,1")
    assert views_at_once(12 * MEGAPIXEL, 100 * each) == 2
    assert views_at_once(12 * MEGAPIXEL, 3.5 * each) == 1


def test_free_memory_is_the_container_s_where_it_has_less(tmp_path):
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:  2000 kB\nMemAvailable:   1000 kB\n")
    assert free_memory_mb(tmp_path, meminfo) == pytest.approx(1.024)
    (tmp_path / "memory.max").write_text("max\n")
    assert free_memory_mb(tmp_path, meminfo) == pytest.approx(1.024)
    (tmp_path / "memory.max").write_text("900000\n")
    (tmp_path / "memory.current").write_text("700000\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 100000\n")
    assert free_memory_mb(tmp_path, meminfo) == pytest.approx(0.3)
    assert free_memory_mb(tmp_path / "none", tmp_path / "none") == machine_memory_mb(tmp_path / "none") / 2
