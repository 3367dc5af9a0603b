"""What the numerical libraries may use: as many threads as this process has cores, and which processor's instructions,
unless the user sets it."""

from __future__ import annotations

import math
import os
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")


def available_cores(cgroup: Path = _CGROUP) -> int:
    """Cores that this process may really use: the scheduler's affinity, cut by a container's CPU quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = _cgroup_quota(cgroup)
    return cores if quota is None else max(1, min(cores, math.ceil(quota)))


def allowed_threads() -> int:
    """Threads that this process may use: OMP_NUM_THREADS, where it is set to a number; else `available_cores()`."""
    # It may list a number for every nesting level ("4,2").
    first = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return max(1, int(first)) if first.isdecimal() else available_cores()


def configure_threads() -> None:
    """Give torch, BLAS and numba `available_cores()` threads each, unless the user has set the environment variables.

    The libraries read these variables when they are first imported, so this function must be called before.
    OMP_NUM_THREADS alone holds for all of them; NUMBA_NUM_THREADS overrides it for the kernels.
    """
    cores = os.environ.setdefault("OMP_NUM_THREADS", str(available_cores()))
    # OMP_NUM_THREADS may list a number for every nesting level ("4,2"); numba knows only one.
    os.environ.setdefault("NUMBA_NUM_THREADS", cores.split(",")[0])
    # torch and numba each bring an OpenMP runtime of their own. After a parallel region its threads spin for a while by
    # default, on the cores that the other runtime needs next: with other work on the machine a training step took 4
    # times as long, and some never ended. With PASSIVE they sleep, which costs microseconds.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def configure_processor() -> None:
    """Compile kernels for the processor in NUMBA_CPU_NAME alone, where the user names one (x86-64-v3).

    Without NUMBA_CPU_FEATURES numba would add the features of this machine, and the code run on no other.
    """
    if os.environ.get("NUMBA_CPU_NAME"):
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")


def _cgroup_quota(cgroup: Path) -> float | None:
    """The CPU quota in cores, of cgroup v2 (cpu.max) or v1 (cpu.cfs_*); None where there is none."""
    try:
        if (unified := cgroup / "cpu.max").is_file():
            quota, period = unified.read_text().split()
        else:
            quota = (cgroup / "cpu" / "cpu.cfs_quota_us").read_text().strip()
            period = (cgroup / "cpu" / "cpu.cfs_period_us").read_text().strip()
        return None if quota in ("max", "-1") else int(quota) / int(period)
    except (OSError, ValueError):  # not Linux, no cgroup mounted, or a file in another format
        return None
