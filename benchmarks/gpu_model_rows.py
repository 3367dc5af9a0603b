"""The rows of the tables of `gpu_model.py`: stages, totals, and the forms of the scatter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from gpu_code import Code
from gpu_kernels import MULTIPROCESSORS
from gpu_ops import OPS, Call, Task, training_step
from gpu_peaks import GPUS, LAUNCH, Gpu
from gpu_sizes import Sizes
from gpu_times import Time, kernel_time, predicted, task_times

Row = dict[str, object]
STAGE_COLUMNS = ("workload", "gpu", "stage", "kernel", "milliseconds", "percent", "bound")
TOTAL_COLUMNS = (
    "workload", "gpu", "step_ms", "steps_per_second", "seconds_of_training", "pictures_per_second",
    "pictures_per_second_lens", "launches", "launch_percent", "largest", "largest_percent", "blend_backward_percent",
    "blend_backward_occupancy_percent", "blend_backward_waits_percent", "blend_backward_room",
    "sum_slots_percent", "apart_percent", "twice_the_intersections_ms",
)  # fmt: skip
TASK_COLUMNS = (
    "workload", "gpu", "milliseconds", "forward_ms", "launches", "launch_percent", "largest", "largest_percent",
    "largest_bound",
)  # fmt: skip
SCATTER_COLUMNS = (
    "workload", "gpu", "aperture", "radius", "places", "direct_forward_ms", "direct_both_ms", "linear_forward_ms",
    "linear_both_ms",
)  # fmt: skip
CROSSING_COLUMNS = ("workload", "gpu", "aperture", "forward_px", "backward_px", "both_px")
APERTURES = {"disc": "", "hexagon": "_polygon"}  # and what ops of their shape end with
RADII = (2.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 32.0)  # pixels
FARTHEST = 64  # pixels, up to which it is looked for where the linear form is the faster one
STEPS = 30_000


def stage_rows(task: Task, times: Mapping[tuple[str, str], Sequence[Time]]) -> Iterator[Row]:
    """Milliseconds of each stage of a task and of each kernel in it, with its share of the whole, per cent; the whole
    comes last."""
    for gpu in GPUS:
        many = times[task.name, gpu.name]
        whole = sum(time.seconds for time in many if time.stage in task.stages)
        named: list[tuple[str, str, float, str]] = []
        for stage in (*task.stages, *task.beside):
            inner = [time for time in many if time.stage == stage]
            named.append((stage, "all", sum(time.seconds for time in inner), ""))
            named += [(stage, time.label, time.seconds, time.bound) for time in inner]
            if stage == task.stages[-1]:
                named.append(("all", "all", whole, ""))
        for stage, kernel, seconds, bound in named:
            yield {
                "workload": task.name,
                "gpu": gpu.name,
                "stage": stage,
                "kernel": kernel,
                "milliseconds": 1e3 * seconds,
                "percent": 100 * seconds / whole,
                "bound": bound,
            }


def task_row(task: Task, gpu: Gpu, many: Sequence[Time]) -> Row:
    """What a task takes altogether, and what of it is no gradient, loss or optimiser."""
    inner = [time for time in many if time.stage in task.stages]
    whole, launches = sum(time.seconds for time in inner), sum(time.launches for time in inner)
    largest = max((time for time in inner if time.kernel != "small operations"), key=lambda time: time.seconds)
    return {
        "workload": task.name,
        "gpu": gpu.name,
        "milliseconds": 1e3 * whole,
        "forward_ms": 1e3 * sum(time.seconds for time in inner if not time.backward and time.stage != "loss"),
        "launches": launches,
        "launch_percent": 100 * LAUNCH * launches / whole,
        "largest": largest.label,
        "largest_percent": 100 * largest.seconds / whole,
        "largest_bound": largest.bound,
    }


def total_row(sizes: Sizes, gpu: Gpu, many: Sequence[Time], codes: Sequence[Code]) -> Row:
    """What a training step of Gaussians and a picture take altogether."""
    whole = task_row(training_step(sizes), gpu, many)
    step = 1e-3 * float(str(whole["milliseconds"]))
    drawn = predicted("rasterize", sizes, gpu, codes=codes)
    lens = sum(
        calls * predicted(op, sizes, gpu, codes=codes) for op, calls in (("surface", 1), ("scatter", 1), ("tone", 2))
    )
    named = {time.kernel: time for time in many}
    backward = named["blend_backward"]
    more = training_step(
        replace(sizes, intersections=2 * sizes.intersections, most_intersections=2 * sizes.most_intersections)
    )
    return {
        "workload": sizes.name,
        "gpu": gpu.name,
        "step_ms": 1e3 * step,
        "steps_per_second": 1 / step,
        "seconds_of_training": STEPS * step,
        "pictures_per_second": 1 / drawn,
        "pictures_per_second_lens": 1 / (drawn + lens),
        **{name: whole[name] for name in ("launches", "launch_percent", "largest", "largest_percent")},
        "blend_backward_percent": 100 * backward.seconds / step,
        "blend_backward_occupancy_percent": 100 * backward.occupancy,
        "blend_backward_waits_percent": 100 * (backward.busy - backward.hidden) / backward.busy,
        "blend_backward_room": backward.occupancy * MULTIPROCESSORS[gpu.architecture].warps * gpu.multiprocessors,
        "sum_slots_percent": 100 * named["sum_slots"].seconds / step,
        "apart_percent": 100 * _apart(sizes, gpu, codes) / step,
        "twice_the_intersections_ms": task_row(more, gpu, task_times(more, gpu, codes))["milliseconds"],
    }


def _apart(sizes: Sizes, gpu: Gpu, codes: Sequence[Code]) -> float:
    """Seconds that kernels whose threads read numbers far apart take beyond what they took if neighbours read
    neighbouring numbers."""
    call = Call("rasterize", sizes)
    apart = [one for one in OPS[call.op].kernels if one.name in ("color", "color_backward")]
    beside = [replace(one, apart=0.0) for one in apart]
    before, after = (sum(kernel_time(one, call, gpu, codes).seconds for one in ones) for ones in (apart, beside))
    return before - after


def scatter_rows(sizes: Sizes, codes: Sequence[Code]) -> Iterator[Row]:
    """Times of both forms of the scatter, by aperture and radius, and how many places the direct one visits for each
    pixel."""
    for aperture in APERTURES:
        for radius in RADII:
            one = replace(sizes, radius=radius)
            for gpu in GPUS:
                times = _forms(one, aperture, gpu, codes)
                found = {f"{form}_{way}_ms": 1e3 * seconds for (form, way), seconds in times.items()}
                size = {"workload": sizes.name, "gpu": gpu.name, "aperture": aperture, "radius": radius}
                yield {**size, "places": one.offsets, **found}


def crossing_rows(sizes: Sizes, codes: Sequence[Code]) -> Iterator[Row]:
    """From which radius on, whole pixels, the linear form is the faster one: forward, backward, and both together; none
    where it isn't by FARTHEST."""
    for aperture in APERTURES:
        for gpu in GPUS:
            first: dict[str, int | None] = {"forward": None, "backward": None, "both": None}
            for radius in range(FARTHEST, 0, -1):
                times = _forms(replace(sizes, radius=float(radius)), aperture, gpu, codes)
                gains = {way: times["direct", way] - times["linear", way] for way in ("forward", "both")}
                gains["backward"] = gains["both"] - gains["forward"]
                for way, gain in gains.items():
                    if gain > 0 and first[way] == (None if radius == FARTHEST else radius + 1):
                        first[way] = radius
            found = {f"{way}_px": radius for way, radius in first.items()}
            yield {"workload": sizes.name, "gpu": gpu.name, "aperture": aperture, **found}


def _forms(sizes: Sizes, aperture: str, gpu: Gpu, codes: Sequence[Code]) -> dict[tuple[str, str], float]:
    """Seconds by form, and whether forward or with its gradient."""
    return {
        (form, way): predicted(f"scatter_{form}{APERTURES[aperture]}", sizes, gpu, backward=way == "both", codes=codes)
        for form in ("direct", "linear")
        for way in ("forward", "both")
    }
