"""Predicted times of kernels: by bytes, by the units that their instructions take, and by what warps wait for."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gpu_code
from gpu_kernels import MULTIPROCESSORS
from gpu_ops import OPS, Call, Task
from gpu_pace import NOTHING, Pace
from gpu_peaks import LAUNCH, Gpu
from gpu_work import Kernel, OtherWork

REPORT = Path(__file__).resolve().parents[1] / "reports" / "gpu"


@dataclass(frozen=True)
class Time:
    """A kernel's predicted time. op, kernel, variant, stage, backward: as in `gpu_work.Kernel`; of what isn't a kernel
    here the op is that of `gpu_ops.OPS`. bytes, warp_instructions, launches: of all its calls, as seconds are. bound:
    "memory"; "issue", "fma", "double", "alu", "special" or "load/store", a unit of the multiprocessors; "latency",
    warps that wait; or "launch". busy: seconds without launches and waits. hidden: the same if no warp ever waited.
    occupancy: 0 to 1, NaN of what isn't a kernel here."""

    op: str
    kernel: str
    variant: str
    stage: str
    backward: bool
    bytes: float
    warp_instructions: float
    launches: float
    seconds: float
    bound: str
    busy: float
    hidden: float
    occupancy: float

    @property
    def label(self) -> str:
        """What tables call it."""
        return f"{self.kernel} ({self.variant})" if self.variant else self.kernel


def task_times(task: Task, gpu: Gpu, codes: Iterable[gpu_code.Code] | None = None) -> list[Time]:
    """The times of all that a task calls, of one kernel together. codes: the kernels' machine code; without, that of
    reports/gpu/code.csv."""
    found: dict[tuple[str, str], list[Time]] = defaultdict(list)
    for call in task.calls:
        for time in call_times(call, gpu, codes):
            found[time.stage, time.label].append(time)
    return [_together(same) for same in found.values()]


def predicted(
    op: str,
    sizes: Any,
    gpu: Gpu,
    *,
    backward: bool = False,
    codes: Iterable[gpu_code.Code] | None = None,
) -> float:
    """Seconds of one call of an op of `gpu_ops.OPS`. backward: with its gradient.

    Raises ValueError for another op, and for a GPU of an architecture without code.
    """
    return sum(time.seconds for time in call_times(Call(op, sizes, backward=backward), gpu, codes))


def call_times(call: Call, gpu: Gpu, codes: Iterable[gpu_code.Code] | None) -> list[Time]:
    """The times of an op's kernels and of what is beside them. Raises ValueError as `predicted` does."""
    if call.op not in OPS:
        raise ValueError(f"op {call.op}: expected one of {', '.join(sorted(OPS))}")
    op = OPS[call.op]
    called = (one for one in op.kernels if (call.backward or not one.backward) and one.times(call.sizes))
    return [
        *(kernel_time(one, call, gpu, codes) for one in called),
        *(other_time(one, call, gpu) for one in op.others if call.backward or not one.backward),
    ]


def other_time(work: OtherWork, call: Call, gpu: Gpu) -> Time:
    """The time of what isn't looked at in machine code."""
    moved, launches = work.moved(call.sizes), work.launches(call.sizes)
    busy, beside = moved / (gpu.bandwidth * work.share), launches * LAUNCH + work.wait
    bound = "memory" if busy > beside else "launch"
    return Time(
        call.op, work.name, "", work.stage, work.backward, call.calls * moved, 0.0, call.calls * launches,
        call.calls * (busy + beside), bound, call.calls * busy, call.calls * busy, float("nan"),
    )  # fmt: skip


def kernel_time(kernel: Kernel, call: Call, gpu: Gpu, codes: Iterable[gpu_code.Code] | None) -> Time:
    """The time of a kernel in all calls of its op."""
    sizes, rows = call.sizes, code_of(kernel, gpu.architecture, codes)
    programs, first = kernel.programs(sizes), rows[0]
    each, launches = warp_pace(kernel, rows, sizes), call.calls * kernel.times(sizes)
    warps = programs * first.warps
    cycles = unit_cycles(each, kernel.apart, warps, gpu)
    held = first.occupancy * MULTIPROCESSORS[gpu.architecture].warps
    # Every multiprocessor is filled with warps again and again, each filling takes what one warp takes; and however few
    # they are, the longest program has to end.
    longest = warp_pace(replace(kernel, entered=None), rows, sizes, kernel.longest(sizes))
    cycles["latency"] = max(longest.alone, warps / (gpu.multiprocessors * held) * each.alone)
    seconds = {unit: value / gpu.clock for unit, value in cycles.items()}
    seconds["memory"] = kernel.moved(sizes, gpu) / gpu.bandwidth
    bound = max(seconds, key=lambda unit: seconds[unit])
    busy, hidden = seconds[bound], max(value for unit, value in seconds.items() if unit != "latency")
    return Time(
        kernel.op,
        kernel.name,
        kernel.variant,
        kernel.stage,
        kernel.backward,
        launches * kernel.moved(sizes, gpu),
        launches * warps * each.instructions,
        launches,
        launches * (busy + LAUNCH),
        bound if busy > LAUNCH else "launch",
        launches * busy,
        launches * hidden,
        first.occupancy,
    )


def warp_pace(kernel: Kernel, rows: Sequence[gpu_code.Code], sizes: Any, longer: float = 1.0) -> Pace:
    """What one warp takes in the whole program. longer: its passes over the mean."""
    whole = NOTHING
    largest: dict[int, int] = defaultdict(int)
    for row in rows:
        largest[row.loop] = max(largest[row.loop], row.unrolled)
    for row in rows:
        if row.loop < 0:
            times = kernel.entered(sizes) if row.sometimes and kernel.entered else 1.0
        else:
            loop = kernel.loops[row.loop]
            times = gpu_code.passes(longer * loop.passes(sizes), row.unrolled, largest[row.loop], loop.exact)
            times *= loop.taken(sizes) if row.sometimes else 1.0
        whole = whole.plus(row.pace.times(times))
    return whole


def unit_cycles(each: Pace, apart: float, warps: float, gpu: Gpu) -> dict[str, float]:
    """Cycles that the units of all multiprocessors take for `warps` warps, spread evenly over their four parts: units
    are theirs, and a warp stays in its part. apart: see `gpu_work.Kernel`."""
    share = 4 * math.ceil(warps / (4 * gpu.multiprocessors))
    return {
        "issue": share * each.instructions / gpu.issue,
        "fma": share * each.fma / gpu.fma,
        "double": share * each.double / gpu.double,
        "alu": share * each.alu / gpu.alu,
        "special": share * each.special / gpu.special,
        "load/store": share * (each.memory + apart) / gpu.memory,
    }


def code_of(kernel: Kernel, architecture: int, codes: Iterable[gpu_code.Code] | None) -> list[gpu_code.Code]:
    """The parts of a kernel's code, what runs once first. Raises ValueError where there are none."""
    known = _kept() if codes is None else codes
    key = *kernel.code, architecture
    rows = [row for row in known if (row.op, row.kernel, row.variant, row.architecture) == key]
    if not rows:
        raise ValueError(f"{kernel.op}/{kernel.name}: no code for sm_{architecture}")
    return sorted(rows, key=lambda row: row.loop)


def _together(same: Sequence[Time]) -> Time:
    """Times of one kernel as one, bound by what the longest of them is."""
    most = max(same, key=lambda time: time.seconds)
    sums = ("bytes", "warp_instructions", "launches", "seconds", "busy", "hidden")
    return replace(most, **{name: sum(getattr(time, name) for time in same) for name in sums})


@cache
def _kept() -> tuple[gpu_code.Code, ...]:
    return tuple(gpu_code.read(REPORT / "code.csv"))
