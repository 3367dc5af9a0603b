"""The page of the model of kernel times, from the rows of its tables."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from gpu_peaks import GPUS, LAUNCH, SORT_SHARE, WAIT
from gpu_sizes import Sizes
from gpu_times import Time

Row = Mapping[str, object]
STAGE_COLUMNS = ("workload", "gpu", "stage", "kernel", "milliseconds", "percent", "bound")
TOTAL_COLUMNS = (
    "workload", "gpu", "step_ms", "steps_per_second", "seconds_of_training", "pictures_per_second",
    "pictures_per_second_lens", "launches", "launch_percent", "largest", "largest_percent", "blend_backward_percent",
    "blend_backward_occupancy_percent", "blend_backward_waits_percent", "blend_backward_room",
    "sum_slots_percent", "apart_percent", "twice_the_intersections_ms",
)  # fmt: skip
SCATTER_COLUMNS = ("workload", "gpu", "radius", "places", "forward_ms", "both_ms")

TOTAL_HEAD = (
    "| workload | GPU | step [ms] | steps a second | seconds for {steps} steps | pictures a second | with a lens | "
    "launches | of the step [%] | twice the intersections [ms] |\n"
    "| :--- | :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
)
INTRODUCTION = """# How long the GPU's kernels would take

A model, not a measurement: **nothing here was run on a GPU.** It weighs the published peak figures of three GPUs
against what each kernel has to do, and says what it would wait for. A real GPU doesn't reach its peaks, so times are
rather too short; which kernel dominates, and why, is what the model is for.

A kernel takes as long as the slowest of

- its **memory**: the bytes of its tensors, each read or written once, at the memory's bandwidth;
- a unit of the multiprocessors: the **issue** of instructions, float products and sums (**fma**), integers,
  comparisons and choices (**alu**), special functions and conversions (**special**), loads, stores and shuffles
  (**load/store**). Instructions are counted in the machine code for each GPU, what is in a loop as often as the sizes
  make it pass;
- **latency**: the way of one warp through the program, waiting for every operand, as often as the multiprocessors are
  filled with the warps that their registers have room for, but at least that of the longest program. So occupancy is
  taken into account here;

and {launch:.0f} microseconds more for each launch, which is the bound (**launch**) where the rest takes less. No
kernel has atomics. Torch's sorts reach {sort:.0%} of the bandwidth, as CUB's radix sort is published to do on an
A100; its other operations are bound by memory or launches. The host waits once a picture, for {wait:.0f}
microseconds. Sources of all figures: `benchmarks/gpu_peaks.py` and `benchmarks/gpu_pace.py`.

## Workloads

| workload | Gaussians | picture | for each pixel | visible | tiles of a visible one | Gaussians of a tile | taken |
| :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |
{workloads}

The last four columns come from a measurement on the CPU, [footprints.csv](footprints.csv), by
`python benchmarks/gpu_footprints.py --out reports/gpu`: the built-in scene, trained at 128 x 96 pixels with as many
Gaussians for each pixel. Photographs of a real scene may have wider Gaussians and so longer lists; the table below says
what twice as many intersections would cost. "Taken" are the Gaussians of a tile's list that colour one of its pixels.
The configuration is that of the preset `gpu`: harmonics of degree 3, depth, statistics for density control, L1, SSIM
and edges. The radius that reaches a tile of the scatter is taken to be {radius:.0f} pixels.

## Totals

{total_head}
{totals}

Steps and pictures are those that the device could take; Python may be slower than it in handing over so many
launches.
"""


def page(
    sizes: Sequence[Sizes],
    times: Mapping[tuple[str, str], Sequence[Time]],
    stages: Sequence[Row],
    totals: Sequence[Row],
    scatter: Sequence[Row],
    steps: int,
) -> str:
    """The whole page. times: by workload and GPU; the others: rows of the CSV files."""
    parts = [
        INTRODUCTION.format(
            launch=1e6 * LAUNCH,
            wait=1e6 * WAIT,
            sort=SORT_SHARE,
            radius=sizes[0].radius,
            total_head=TOTAL_HEAD.format(steps=f"{steps:,}".replace(",", " ")),
            workloads="\n".join(map(_workload, sizes)),
            totals="\n".join(map(_total, totals)),
        ),
        *(_stages(one, stages) for one in sizes),
        _scatter(scatter),
        _design(sizes, times, totals, scatter),
        *map(_point, WEAKEST),
    ]
    return "\n".join(parts) + "\n"


def _workload(one: Sizes) -> str:
    list_length = one.pairs / one.tiles
    return (
        f"| {one.name} | {one.gaussians} | {one.width} x {one.height} | {one.gaussians / one.pixels:.1f} | "
        f"{one.visible:.0%} | {one.intersections:.2f} | {list_length:.0f} | {one.looked_at * one.taken:.1%} |"
    )


def _total(row: Row) -> str:
    cells = (
        f"{row['step_ms']:.2f}", f"{row['steps_per_second']:.0f}", f"{row['seconds_of_training']:.0f}",
        f"{row['pictures_per_second']:.0f}", f"{row['pictures_per_second_lens']:.0f}", row["launches"],
        f"{row['launch_percent']:.0f}", f"{row['twice_the_intersections_ms']:.2f}",
    )  # fmt: skip
    return f"| {row['workload']} | {row['gpu']} | {' | '.join(map(str, cells))} |"


def _stages(one: Sizes, stages: Sequence[Row]) -> str:
    """The table of one workload: each stage, and the kernels in it."""
    lines = [
        f"## A training step: {one.name}",
        "",
        "| stage | kernel | " + " | ".join(f"{gpu.name} [ms] | bound" for gpu in GPUS) + " |",
        "| :--- | :--- |" + " ---: | :--- |" * len(GPUS),
    ]
    rows = [row for row in stages if row["workload"] == one.name]
    for first in (row for row in rows if row["gpu"] == GPUS[0].name):
        same = [row for row in rows if (row["stage"], row["kernel"]) == (first["stage"], first["kernel"])]
        cells = " | ".join(f"{row['milliseconds']:.3f} | {row['bound']}" for row in same)
        names = f"**{first['stage']}** | " if first["kernel"] == "all" else f" | {first['kernel']}"
        lines.append(f"| {names} | {cells} |")
    return "\n".join([*lines, ""])


def _scatter(rows: Sequence[Row]) -> str:
    """The table of the scatter by radius."""
    names = [gpu.name for gpu in GPUS]
    lines = [
        "## The scatter by radius",
        "",
        f"The direct form with its gradient, at {rows[0]['workload']}'s size.",
        "",
        "| radius [px] | places for a pixel | " + " | ".join(f"{name} [ms]" for name in names) + " |",
        "| ---: | ---: |" + " ---: |" * len(names),
    ]
    for first in (row for row in rows if row["gpu"] == names[0]):
        cells = [f"{row['both_ms']:.3f}" for row in rows if row["radius"] == first["radius"]]
        lines.append(f"| {first['radius']:.0f} | {first['places']} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _design(
    sizes: Sequence[Sizes],
    times: Mapping[tuple[str, str], Sequence[Time]],
    totals: Sequence[Row],
    scatter: Sequence[Row],
) -> str:
    """What follows for the design, each sentence from the rows."""
    largest = "; ".join(
        f"`{name}` for "
        + ", ".join(
            f"{row['workload']} on the {row['gpu']} ({row['largest_percent']:.0f} %)"
            for row in totals
            if row["largest"] == name
        )
        for name in sorted({str(row["largest"]) for row in totals})
    )
    waits = "; ".join(
        f"{one.name} {_span(_values(totals, 'blend_backward_waits_percent', one.name))} %" for one in sizes
    )
    bounds = sorted({t.bound for many in times.values() for t in many if t.kernel == "blend_backward"})
    occupancy = _values(totals, "blend_backward_occupancy_percent")
    apart, launch = _values(totals, "apart_percent"), _values(totals, "launch_percent")
    room = min(_values(totals, "blend_backward_room"))
    widest = max(float(str(row["radius"])) for row in scatter)
    at_widest = _values([row for row in scatter if row["radius"] == widest], "both_ms")
    at_usual = _values([row for row in scatter if row["radius"] == sizes[0].radius], "both_ms")
    steps = _values(totals, "step_ms", sizes[0].name)
    shares = [100 * wide / (step - usual + wide) for wide, usual, step in zip(at_widest, at_usual, steps, strict=True)]
    few = sizes[0].tiles < room
    points = [
        f"**What dominates.** The longest kernel, with its share of a step, is {largest}.",
        f"**Does the low occupancy of `blend_backward` matter?** With one warp for each tile it fills "
        f"{_span(occupancy)} % of the warps that a multiprocessor holds. It is bound by {', '.join(bounds)}. "
        f"Warps that wait cost of its time: {waits}. More occupancy could gain no more than that: a thread's eight "
        "pixels don't depend on each other, so one warp has much to do while it waits."
        + (
            f" Where warps do wait, it isn't for lack of registers: {sizes[0].name} has {sizes[0].tiles} tiles and "
            f"so as many warps, the smallest of the GPUs has room for {room:.0f}, and the tile with the longest list "
            "ends last. Two warps for a tile would help there, fewer registers wouldn't."
        )
        * few,
        "**Numbers of one Gaussian that lie beside each other.** In `color` and `color_backward` each thread reads its "
        "own Gaussian's 45 coefficients and writes their gradients, so that every load and store of a warp touches 32 "
        "lines. If neighbouring threads took neighbouring numbers, a step would take up to "
        f"{max(apart):.0f} % less. `mix` has the same pattern in its logits.",
        "**A warp for each Gaussian.** `sum_slots` spends one on every Gaussian, visible or not, most of it on "
        f"instructions before and behind its loop: {_span(_values(totals, 'sum_slots_percent'))} % of a step. Several "
        "Gaussians for a warp would share them.",
        f"**Launches.** They are {_span(launch)} % of a step, mostly torch's small operations and not these kernels. "
        "Where the share is large, a CUDA graph or fewer operations gain more than a faster kernel.",
        f"**The scatter.** At {widest:.0f} pixels the direct form takes {_span(at_widest, 2)} ms, {_span(shares)} % "
        f"of a step of {sizes[0].name} with it. Tiles of wide circles have the linear form instead, which isn't in "
        "this model: [which is faster where](../notes/gpu.md).",
    ]
    return "\n".join(["## What follows for the design", "", *map(_point, points), "", "## What is weakest in it", ""])


WEAKEST = (
    "Intersections for each Gaussian, see above: most kernels' times go with them.",
    "Caches: L1 and L2 have no bandwidth of their own here, and what is read again is taken to be there, except "
    "records that don't fit in L2. That a store whose threads write far apart takes a cycle for each line is assumed.",
    "How unlike the tiles' lists are comes from a picture of 48 tiles; a large picture's longest list is longer.",
    "Branches within a warp: both sides are counted, except in the loop of `blend_backward`, whose branch is taken as "
    "often as measured.",
    "A launch's and a wait's time are assumed, and so are latencies of special functions and shuffles. Torch's small "
    "operations were counted in a training on the CPU, and Python may take longer for one than a launch.",
)


def _point(text: str) -> str:
    """An item of a list, in lines that a text editor shows."""
    return textwrap.fill(f"- {text}", 118, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def _values(rows: Sequence[Row], column: str, workload: str | None = None) -> list[float]:
    """A column of the rows, or of those of one workload."""
    return [float(str(row[column])) for row in rows if workload is None or row["workload"] == workload]


def _span(values: Sequence[float], digits: int = 0) -> str:
    """The smallest and the largest of some values, or the one that they all are."""
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"
