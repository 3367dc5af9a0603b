"""Whether a process that a signal ended had run out of memory, by what its parent can observe (on Linux)."""

from __future__ import annotations

import re
import resource
import signal
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

SAMPLE_EVERY = 0.2  # seconds
# Native code that can't allocate memory fails in these ways, and some bugs do too.
_NATIVE = {signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGILL, signal.SIGTRAP}
# Limit -> the entry of /proc/PID/status that it bounds, and the command that sets it
_LIMITS = {resource.RLIMIT_AS: ("VmPeak", "ulimit -v"), resource.RLIMIT_DATA: ("VmData", "ulimit -d")}
# The share of a limit that must have been in use. A failed allocation isn't part of the peak, and one of a library's
# data, of an array or of a thread's arena takes up to a third of the limits at which this program can start at all.
_NEAR_LIMIT = 0.65
_RECENT = 150  # samples: the kernel kills a process up to half a minute before it has ended


class MemoryWatch:
    """Samples the memory of a child process while it lives, to judge its end."""

    def __init__(self, pid: int, system: Path = Path("/")):
        self._status, self._system = system / f"proc/{pid}/status", system
        self._peaks: dict[str, int] = {}
        self._kills: deque[int] = deque(maxlen=_RECENT)
        self._last = -SAMPLE_EVERY
        self.sample()

    def sample(self) -> None:
        """Read the peaks; a call within half of `SAMPLE_EVERY` after the last one does nothing."""
        now = time.monotonic()
        if now - self._last < SAMPLE_EVERY / 2:
            return
        self._last = now
        with suppress(OSError):  # not Linux, or ended
            for name, kilobytes in re.findall(r"^(Vm\w+):\s+(\d+) kB", self._status.read_text(), re.MULTILINE):
                self._peaks[name] = max(self._peaks.get(name, 0), int(kilobytes) * 1024)
        self._kills.append(_oom_kills(self._system))

    @property
    def peak_mb(self) -> float:
        """Largest resident memory seen, MB."""
        return self._peaks.get("VmHWM", 0) / 1e6

    def evidence(self, number: int) -> str:
        """One line that says why the process, ended by the signal `number`, was out of memory; "" without evidence."""
        name = signal.Signals(number).name
        if number == signal.SIGKILL and _oom_kills(self._system) > self._kills[0]:
            return f"ended by {name} when the kernel's OOM killer acted, at {self.peak_mb:.0f} MB of resident memory"
        for limit, (entry, command) in _LIMITS.items() if number in _NATIVE else ():
            most, peak = resource.getrlimit(limit)[0], self._peaks.get(entry, 0)
            if most != resource.RLIM_INFINITY and peak >= _NEAR_LIMIT * most:
                used = f"{peak / 1e6:.0f} MB of address space"
                return f"ended by {name} at {used}, with a limit of {most / 1e6:.0f} MB ({command})"
        return ""


def _oom_kills(system: Path) -> int:
    """How many processes the OOM killer has ended in this process's cgroup; where it doesn't count, on the machine."""
    groups = ""
    with suppress(OSError):
        groups = (system / "proc/self/cgroup").read_text()
    files = [
        *(system / f"sys/fs/cgroup{path}/memory.events" for path in re.findall(r"^0::(/.*)$", groups, re.MULTILINE)),
        system / "sys/fs/cgroup/memory.events",  # a container's, which is shown as the root
        *(
            system / f"sys/fs/cgroup/memory{path}/memory.oom_control"
            for path in re.findall(r"^\d+:[\w,]*\bmemory\b[\w,]*:(/.*)$", groups, re.MULTILINE)
        ),
        system / "sys/fs/cgroup/memory/memory.oom_control",
        system / "proc/vmstat",
    ]
    for file in files:
        with suppress(OSError):
            if found := re.search(r"^oom_kill (\d+)$", file.read_text(), re.MULTILINE):
                return int(found[1])
    return 0
