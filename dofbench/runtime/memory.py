"""Memory that this machine has, and that is free on it."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")
# Of cgroup v2 and v1: limit, use, and the entry of memory.stat with cached files, which the kernel drops when it must.
_CGROUP_FILES = (
    ("memory.max", "memory.current", "memory.stat", "inactive_file"),
    (
        "memory/memory.limit_in_bytes",
        "memory/memory.usage_in_bytes",
        "memory/memory.stat",
        "total_inactive_file",
    ),
)


def machine_memory_mb(cgroup: Path = _CGROUP) -> float:
    """Memory that processes here may use, MB: the machine's, or the container's where that is less."""
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for name, *_ in _CGROUP_FILES:
        with suppress(OSError, ValueError):  # no Linux, no such cgroup, or "max"
            limits.append(int((cgroup / name).read_text()))
    return min(limits) / 1e6


def free_memory_mb(cgroup: Path = _CGROUP, meminfo: Path = Path("/proc/meminfo")) -> float:
    """Memory that processes here may still take, MB: the machine's, or the container's where that is less. Where the
    system doesn't say, half of what there is."""
    free = []
    with suppress(OSError, KeyError):
        free.append(1024 * _entries(meminfo)["MemAvailable"])
    for limit, used, statistics, files in _CGROUP_FILES:
        with suppress(OSError, ValueError, KeyError):
            kept = _entries(cgroup / statistics)[files]
            free.append(int((cgroup / limit).read_text()) - int((cgroup / used).read_text()) + kept)
    return max(0, min(free)) / 1e6 if free else machine_memory_mb(cgroup) / 2


def _entries(file: Path) -> dict[str, int]:
    """The numbers in a file of lines such as `MemAvailable:  1024 kB`, by name."""
    return {name: int(value) for name, value in re.findall(r"^(\w+):?\s+(\d+)", file.read_text(), re.MULTILINE)}
