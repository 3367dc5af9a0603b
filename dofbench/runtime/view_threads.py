"""Work on several views at a time, in threads of this process.

Threads suffice, because almost all of the time of a view is spent outside of Python's lock: in decoding, encoding,
resampling and arithmetic on whole images. Kernels hold the lock, but use all cores themselves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

from dofbench.runtime.memory import free_memory_mb
from dofbench.runtime.threads import allowed_threads, available_cores

View = TypeVar("View")
Result = TypeVar("Result")

# Bytes per pixel that a stage of make-dataset takes at most for a view; the blur takes 90.
BYTES_PER_PIXEL = 130
_MOST = 16  # views at a time: each of their threads has a team of the kernels' threads
_AHEAD = 2  # results per thread that may wait for an earlier view's


def views_at_once(pixels: int, free_mb: float | None = None) -> int:
    """How many views of so many pixels to work on at a time: one for each thread that this process may use, as far as
    its share of the free memory suffices.

    free_mb: for all processes, MB; None for what is free now.
    """
    threads = allowed_threads()
    share = min(1.0, threads / available_cores()) * (free_memory_mb() if free_mb is None else free_mb)
    return max(1, min(threads, _MOST, int(share * 1e6 / (BYTES_PER_PIXEL * max(1, pixels)))))


def over_views(work: Callable[[View], Result], views: Iterable[View], at_once: int) -> Iterator[Result]:
    """Yield `work` of each view, in the order of the views, done `at_once` views at a time.

    Threads are at most a few views ahead of what is taken, so that results don't pile up. An exception of `work` is
    raised in its view's place. Then, and when the iterator is closed or interrupted, no further view is started, and
    those at work are finished first: a thread that is stopped from outside may keep a lock. A second interruption
    doesn't wait for them.
    """
    views = list(views)
    if min(at_once, len(views)) <= 1:
        yield from map(work, views)
        return
    threads = _Threads(work, views, min(at_once, len(views)))
    try:
        threads.start()
        for index in range(len(views)):
            yield threads.result(index)
    finally:
        threads.stop()


class _Threads(Generic[View, Result]):
    def __init__(self, work: Callable[[View], Result], views: list[View], count: int):
        self._work, self._views, self._ahead = work, views, _AHEAD * count
        self._changed = threading.Condition()
        self._started, self._wanted, self._stopped = 0, 0, False
        self._results: dict[int, Result] = {}
        self._errors: dict[int, BaseException] = {}
        # Daemons, so that a second Ctrl-C ends the process without waiting for them.
        self._threads = [threading.Thread(target=self._run, name=f"view-{one}", daemon=True) for one in range(count)]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def result(self, index: int) -> Result:
        """The result of the next view. Raises what its work raised."""
        with self._changed:
            self._wanted = index
            self._changed.notify_all()
            while index not in self._results and index not in self._errors:
                self._changed.wait()
            if index in self._errors:
                raise self._errors[index]
            return self._results.pop(index)

    def stop(self) -> None:
        """Start no further view, and wait until those at work are finished."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()

    def _run(self) -> None:
        while (index := self._next()) is not None:
            try:
                result = self._work(self._views[index])
            except BaseException as error:
                with self._changed:
                    self._errors[index] = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._results[index] = result
                self._changed.notify_all()
            del result  # which may be large

    def _next(self) -> int | None:
        """The view to work on; None where there is none, or where an earlier one failed."""
        with self._changed:
            while True:
                if self._stopped or self._errors or self._started == len(self._views):
                    return None
                if self._started <= self._wanted + self._ahead:
                    self._started += 1
                    return self._started - 1
                self._changed.wait()
