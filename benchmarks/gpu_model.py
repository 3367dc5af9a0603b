"""A model of how long each GPU kernel takes on GPUs that nobody here has: model.csv and its tables, and model.md.

    python benchmarks/gpu_model.py --out reports/gpu

A kernel takes as long as the slowest of these: its bytes at the memory's published bandwidth; its warp instructions at
the published rates of the multiprocessors' units; and one warp's way through the program, waiting for its operands, as
often as the multiprocessors are filled with warps (`gpu_times.py`). Instructions are counted in the machine code that
Triton's assembler makes for each GPU (`gpu_sass.py`, `gpu_pace.py`, `gpu_code.py`), their loops by the sizes of the
workload (`gpu_sizes.py`, `gpu_work.py`); what torch does itself is bound by memory or launches (`gpu_torch_work.py`).
Peak figures and their sources: `gpu_peaks.py`. Nothing is run on a GPU.

Another script compares what it measures: `gpu_times.predicted("scatter", sizes, gpu, backward=True)`, seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import gpu_code
import gpu_model_page
import tyro
from gpu_kernels import MULTIPROCESSORS
from gpu_peaks import GPUS, LAUNCH, Gpu
from gpu_sizes import Sizes, workloads
from gpu_times import Time, kernel_time, predicted, step
from gpu_work import KERNELS

from dofbench.core.files import write_text
from dofbench.reporting.csv_writer import write_csv

COLUMNS = (
    "workload", "gpu", "op", "kernel", "stage", "backward", "bytes", "warp_instructions", "launches", "seconds",
    "bound", "occupancy",
)  # fmt: skip
STAGES = (
    "projection", "lists", "sort", "blend forward", "lens forward", "loss", "lens backward", "blend backward",
    "projection backward", "Adam", "small operations",
)  # fmt: skip
RADII = (2.0, 4.0, 8.0, 16.0, 32.0)  # pixels
STEPS = 30_000


@dataclass(frozen=True)
class Settings:
    """Where the tables are."""

    out: Path
    """Folder for model.csv and what belongs to it; footprints.csv is there already."""
    compile: bool = True
    """Compile the kernels again; otherwise their instructions come from the folder's code.csv."""


def main(settings: Settings) -> None:
    """Write all tables and the page."""
    if settings.compile:
        gpu_code.write(settings.out / "code.csv", gpu_code.compile_all(sorted({gpu.architecture for gpu in GPUS})))
    codes = gpu_code.read(settings.out / "code.csv")
    sizes = workloads(settings.out)
    times = {(one.name, gpu.name): step(one, gpu, codes) for one in sizes for gpu in GPUS}
    write_csv(settings.out / "model.csv", COLUMNS, list(kernel_rows(times)))
    stages = list(stage_rows(times))
    write_csv(settings.out / "model_stages.csv", gpu_model_page.STAGE_COLUMNS, stages)
    totals = [total_row(one, gpu, times[one.name, gpu.name], codes) for one in sizes for gpu in GPUS]
    write_csv(settings.out / "model_totals.csv", gpu_model_page.TOTAL_COLUMNS, totals)
    scatter = list(scatter_rows(sizes[0], codes))
    write_csv(settings.out / "model_scatter.csv", gpu_model_page.SCATTER_COLUMNS, scatter)
    write_text(
        settings.out / "model.md",
        gpu_model_page.page(sizes, times, stages, totals, scatter, STEPS),
    )


def kernel_rows(times: dict[tuple[str, str], list[Time]]) -> Iterator[dict[str, object]]:
    """The rows of model.csv."""
    for (workload, gpu), many in times.items():
        for time in many:
            row = {name: getattr(time, name) for name in COLUMNS if hasattr(time, name)}
            row["occupancy"] = None if time.occupancy != time.occupancy else time.occupancy
            yield {"workload": workload, "gpu": gpu, **row}


def stage_rows(times: dict[tuple[str, str], list[Time]]) -> Iterator[dict[str, object]]:
    """Milliseconds of each stage of a training step and of each kernel in it, with its share of the step, per cent."""
    for (workload, gpu), many in times.items():
        whole = sum(time.seconds for time in many if time.stage in STAGES)
        for stage in STAGES:
            inner = [time for time in many if time.stage == stage]
            rows = [("all", sum(time.seconds for time in inner), ""), *((t.kernel, t.seconds, t.bound) for t in inner)]
            for kernel, seconds, bound in rows:
                yield {
                    "workload": workload,
                    "gpu": gpu,
                    "stage": stage,
                    "kernel": kernel,
                    "milliseconds": 1e3 * seconds,
                    "percent": 100 * seconds / whole,
                    "bound": bound,
                }


def total_row(sizes: Sizes, gpu: Gpu, many: list[Time], codes: list[gpu_code.Code]) -> dict[str, object]:
    """What a step and a picture take altogether."""
    inner = [time for time in many if time.stage in STAGES]
    whole = sum(time.seconds for time in inner)
    drawn = predicted("rasterize", sizes, gpu, codes=codes)
    lens = predicted("scatter", sizes, gpu, codes=codes) + 2 * predicted("tone", sizes, gpu, codes=codes)
    named = {time.kernel: time for time in inner}
    backward = named["blend_backward"]
    largest = max((time for time in inner if time.kernel != "small operations"), key=lambda time: time.seconds)
    # The kernels whose threads read numbers far apart, and the same if neighbours read neighbouring numbers.
    apart = [kernel for kernel in KERNELS if kernel.name in ("color", "color_backward")]
    saved = sum(
        named[one.name].seconds - kernel_time(replace(one, apart=0.0), sizes, gpu, codes, 1).seconds for one in apart
    )
    more = replace(sizes, intersections=2 * sizes.intersections, most_intersections=2 * sizes.most_intersections)
    twice = sum(time.seconds for time in step(more, gpu, codes) if time.stage in STAGES)
    return {
        "workload": sizes.name,
        "gpu": gpu.name,
        "step_ms": 1e3 * whole,
        "steps_per_second": 1 / whole,
        "seconds_of_training": STEPS * whole,
        "pictures_per_second": 1 / drawn,
        "pictures_per_second_lens": 1 / (drawn + lens),
        "launches": sum(time.launches for time in inner),
        "launch_percent": 100 * LAUNCH * sum(time.launches for time in inner) / whole,
        "largest": largest.kernel,
        "largest_percent": 100 * largest.seconds / whole,
        "blend_backward_percent": 100 * backward.seconds / whole,
        "blend_backward_occupancy_percent": 100 * backward.occupancy,
        "blend_backward_waits_percent": 100 * (backward.busy - backward.hidden) / backward.busy,
        "blend_backward_room": backward.occupancy * MULTIPROCESSORS[gpu.architecture].warps * gpu.multiprocessors,
        "sum_slots_percent": 100 * named["sum_slots"].seconds / whole,
        "apart_percent": 100 * saved / whole,
        "twice_the_intersections_ms": 1e3 * twice,
    }


def scatter_rows(sizes: Sizes, codes: list[gpu_code.Code]) -> Iterator[dict[str, object]]:
    """Times of the scatter, the direct form, by radius, and how many places it visits for each pixel."""
    for radius in RADII:
        one = replace(sizes, radius=radius)
        for gpu in GPUS:
            yield {
                "workload": sizes.name,
                "gpu": gpu.name,
                "radius": radius,
                "places": one.offsets,
                "forward_ms": 1e3 * predicted("scatter", one, gpu, codes=codes),
                "both_ms": 1e3 * predicted("scatter", one, gpu, backward=True, codes=codes),
            }


if __name__ == "__main__":
    main(tyro.cli(Settings))
