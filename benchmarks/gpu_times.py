"""Predicted times of kernels: by bytes, by the units that their instructions take, and by what warps wait for."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import gpu_code
from gpu_kernels import MULTIPROCESSORS
from gpu_pace import NOTHING, Pace
from gpu_peaks import LAUNCH, Gpu
from gpu_sizes import Sizes
from gpu_torch_work import TORCH, TorchWork
from gpu_work import KERNELS, Kernel

REPORT = Path(__file__).resolve().parents[1] / "reports" / "gpu"


@dataclass(frozen=True)
class Time:
    """A kernel's predicted time. stage, backward: as in `gpu_work.Kernel`. bytes, warp_instructions, launches: of all
    its calls in a training step, as seconds are. bound: "memory"; "issue", "fma", "alu", "special" or "load/store", a
    unit of the multiprocessors; "latency", warps that wait; or "launch". busy: seconds without launches and waits.
    hidden: the same if no warp ever waited. occupancy: 0 to 1, NaN for torch's own."""

    op: str
    kernel: str
    stage: str
    backward: bool
    bytes: float
    warp_instructions: float
    launches: int
    seconds: float
    bound: str
    busy: float
    hidden: float
    occupancy: float


def step(sizes: Sizes, gpu: Gpu, codes: Iterable[gpu_code.Code] | None = None) -> list[Time]:
    """The times of all kernels of a training step, and with no calls in one those of `mix`.

    codes: the kernels' machine code; without, that of reports/gpu/code.csv.
    """
    return [
        *(kernel_time(kernel, sizes, gpu, codes, max(kernel.calls, 1)) for kernel in KERNELS),
        *(torch_time(work, sizes, gpu) for work in TORCH),
    ]


def predicted(
    op: str,
    sizes: Sizes,
    gpu: Gpu,
    *,
    backward: bool = False,
    codes: Iterable[gpu_code.Code] | None = None,
) -> float:
    """Seconds of one call of an op: "tone", "ssim", "scatter", "mix" or "rasterize". backward: with its gradient.

    Raises ValueError for another op, and for a GPU of an architecture without code.
    """
    kernels = [one for one in KERNELS if one.op == op and (backward or not one.backward)]
    if not kernels:
        raise ValueError(f"op {op}: expected one of {', '.join(sorted({one.op for one in KERNELS}))}")
    works = [one for one in TORCH if one.op == op and (backward or not one.backward)]
    times = [kernel_time(one, sizes, gpu, codes, 1) for one in kernels]
    return sum(time.seconds for time in (*times, *(torch_time(one, sizes, gpu) for one in works)))


def torch_time(work: TorchWork, sizes: Sizes, gpu: Gpu) -> Time:
    """The time of torch's own operations."""
    moved, launches = work.moved(sizes), work.launches(sizes)
    busy = moved / (gpu.bandwidth * work.share)
    beside = launches * LAUNCH + work.wait
    bound = "memory" if busy > beside else "launch"
    return Time(
        work.op, work.name, work.stage, work.backward, moved, 0.0, launches, busy + beside, bound, busy, busy,
        float("nan"),
    )  # fmt: skip


def kernel_time(kernel: Kernel, sizes: Sizes, gpu: Gpu, codes: Iterable[gpu_code.Code] | None, calls: int) -> Time:
    """The time of `calls` calls of a kernel."""
    rows = code_of(kernel, gpu.architecture, codes)
    programs, first = kernel.programs(sizes), rows[0]
    each = warp_pace(kernel, rows, sizes)
    warps = programs * first.warps
    cycles = unit_cycles(each, kernel.apart, warps, gpu)
    held = first.occupancy * MULTIPROCESSORS[gpu.architecture].warps
    # Every multiprocessor is filled with warps again and again, each filling takes what one warp takes; and however few
    # they are, the longest program has to end.
    cycles["latency"] = max(kernel.longest(sizes), warps / (gpu.multiprocessors * held)) * each.alone
    seconds = {unit: value / gpu.clock for unit, value in cycles.items()}
    seconds["memory"] = kernel.moved(sizes, gpu) / gpu.bandwidth
    bound = max(seconds, key=lambda unit: seconds[unit])
    busy, hidden = seconds[bound], max(value for unit, value in seconds.items() if unit != "latency")
    return Time(
        kernel.op,
        kernel.name,
        kernel.stage,
        kernel.backward,
        calls * kernel.moved(sizes, gpu),
        calls * warps * each.instructions,
        calls,
        calls * (busy + LAUNCH),
        bound if busy > LAUNCH else "launch",
        calls * busy,
        calls * hidden,
        first.occupancy,
    )


def warp_pace(kernel: Kernel, rows: list[gpu_code.Code], sizes: Sizes) -> Pace:
    """What one warp takes in the whole program."""
    whole = NOTHING
    largest: dict[int, int] = defaultdict(int)
    for row in rows:
        largest[row.loop] = max(largest[row.loop], row.unrolled)
    for row in rows:
        times = 1.0
        if row.loop >= 0:
            loop = kernel.loops[row.loop]
            times = gpu_code.passes(loop.passes(sizes), row.unrolled, largest[row.loop], loop.exact)
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
        "alu": share * each.alu / gpu.alu,
        "special": share * each.special / gpu.special,
        "load/store": share * (each.memory + apart) / gpu.memory,
    }


def code_of(kernel: Kernel, architecture: int, codes: Iterable[gpu_code.Code] | None) -> list[gpu_code.Code]:
    """The parts of a kernel's code, what runs once first. Raises ValueError where there are none."""
    known = _kept() if codes is None else codes
    rows = [row for row in known if (row.op, row.kernel, row.architecture) == (kernel.op, kernel.name, architecture)]
    if not rows:
        raise ValueError(f"{kernel.op}/{kernel.name}: no code for sm_{architecture}")
    return sorted(rows, key=lambda row: row.loop)


@cache
def _kept() -> tuple[gpu_code.Code, ...]:
    return tuple(gpu_code.read(REPORT / "code.csv"))
