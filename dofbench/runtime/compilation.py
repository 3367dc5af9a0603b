"""JIT compilation on several cores: other processes compile some ops' kernels, this one the rest.

Numba holds one lock while it compiles, so threads wouldn't help. The code comes back through the cache on disk; if it
is there already, no process is started.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Collection, Iterator
from time import monotonic

from dofbench.runtime import kernel_cache
from dofbench.runtime.ops import is_warm, warm_up
from dofbench.runtime.threads import available_cores

_PATIENCE = 300.0  # seconds to wait for the other processes; after that this process compiles what is missing
_MOST = 3  # other processes; one takes half a gigabyte

_ahead: Compilation | None = None


def compile_ahead(ops: Collection[str]) -> None:
    """Start to compile in the background what of these ops isn't on disk, in this order; `compile_all` takes it over.

    Nothing starts on a single core, or where it has been started before.
    """
    global _ahead
    if _ahead is None and (cold := [op for op in ops if not is_warm(op)]):
        _ahead = Compilation(cold)


def compile_all(ops: Collection[str], device: str = "cpu") -> None:
    """Compile the ops' kernels that aren't on disk, here and in other processes. Other ops in the background are not
    begun any more. On other devices nothing is compiled in other processes."""
    global _ahead
    if device != "cpu":
        for op in ops:
            warm_up(op, device)
        return
    running, _ahead = _ahead, None
    cold = [op for op in ops if not is_warm(op)]
    if running is None and len(cold) > 1:
        running = Compilation(cold)
    with _no_collection():
        if running is not None:
            running.finish(cold)
        for op in cold:
            if running is None or not is_warm(op):
                warm_up(op)


class Compilation:
    """Other processes at work on a list of ops, which this process shortens from its end."""

    def __init__(self, ops: Collection[str]) -> None:
        self._waiting, self._lock = deque(ops), threading.Lock()
        cores = int(os.environ.get("NUMBA_NUM_THREADS", available_cores()))
        self._processes = [_compiler() for _ in range(min(cores - 1, len(ops), _MOST))]
        self._feeders = [threading.Thread(target=self._feed, args=[one], daemon=True) for one in self._processes]
        for feeder in self._feeders:
            feeder.start()

    def finish(self, needed: Collection[str]) -> None:
        """Compile here too until every one of the ops that is needed has been compiled or begun, and wait for the
        others."""
        with self._lock:
            self._waiting = deque(op for op in self._waiting if op in needed)
        try:
            while (op := self._next(last=True)) is not None:
                warm_up(op)
            end = monotonic() + _PATIENCE
            for feeder in self._feeders:
                feeder.join(max(0.0, end - monotonic()))
        finally:
            for process in self._processes:
                process.kill()

    def _next(self, *, last: bool = False) -> str | None:
        with self._lock:
            return (self._waiting.pop() if last else self._waiting.popleft()) if self._waiting else None

    def _feed(self, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None and process.stdout is not None
        with process, contextlib.suppress(BrokenPipeError):
            while (op := self._next()) is not None:
                print(op, file=process.stdin, flush=True)
                if not (answer := process.stdout.readline()):
                    return  # it died; this process compiles what is missing
                kernel_cache.add_compiled(int(answer))


def _compiler() -> subprocess.Popen[str]:
    command = [sys.executable, "-P", "-m", "dofbench.runtime.compilation"]
    pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nothing, text=True)


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Without the garbage collector, which would take a tenth of the compile time, for nothing."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


if __name__ == "__main__":
    gc.disable()
    before = 0
    for line in sys.stdin:
        warm_up(line.strip())
        print(kernel_cache.compiled() - before, flush=True)
        before = kernel_cache.compiled()
