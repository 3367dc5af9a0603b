"""The page of the model of kernel times, from the rows of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gpu_model_design as says
import gpu_model_tables as tables
from gpu_model_rows import STEPS
from gpu_model_tables import Row
from gpu_ops import CELLS_EVERY, Task
from gpu_peaks import LAUNCH, SORT_SHARE, WAIT
from gpu_sizes import LENS_POINTS, Sizes
from gpu_sizes_field import ALONG, FieldSizes
from gpu_times import Time

INTRODUCTION = """# How long the GPU's kernels would take

A model, not a measurement: **nothing here was run on a GPU.** It weighs the published peak figures of three GPUs
against what each kernel has to do, and says what it would wait for. A real GPU doesn't reach its peaks, so times are
rather too short; which kernel dominates, and why, is what the model is for. All {count} Triton kernels are in it.
The host that hands over the launches is not, and on an H200 a training step of this size took several times as long for
its sake ([measured](measured.md), [notes](../notes/gpu.md)).

A kernel takes as long as the slowest of

- its **memory**: the bytes of its tensors, each read or written once, at the memory's bandwidth;
- a unit of the multiprocessors: the **issue** of instructions, float products and sums (**fma**), those of float64
  (**double**), integers, comparisons and choices (**alu**), special functions and conversions (**special**), loads,
  stores and shuffles (**load/store**). Instructions are counted in the machine code for each GPU, what is in a loop as
  often as the sizes make it pass;
- **latency**: the way of one warp through the program, waiting for every operand, as often as the multiprocessors are
  filled with the warps that their registers have room for, but at least that of the longest program. So occupancy is
  taken into account here;

and {launch:.0f} microseconds more for each launch, which is the bound (**launch**) where the rest takes less. No
kernel has atomics. Torch's sorts reach {sort:.0%} of the bandwidth, as CUB's radix sort is published to do on an
A100; its other operations are bound by memory or launches. The host waits once a picture, and once when rays are
sampled, for {wait:.0f} microseconds. Sources of all figures: `benchmarks/gpu_peaks.py` and `benchmarks/gpu_pace.py`.

## Workloads

{gaussians}
The last four columns come from a measurement on the CPU, [footprints.csv](footprints.csv), by
`python benchmarks/gpu_footprints.py --out reports/gpu`: the built-in scene, trained at 128 x 96 pixels with as many
Gaussians for each pixel. Photographs of a real scene may have wider Gaussians and so longer lists; the table below says
what twice as many intersections would cost. "Taken" are the Gaussians of a tile's list that colour one of its pixels.
The configuration is that of the preset `gpu`: harmonics of degree 3, depth, statistics for density control, L1, SSIM
and edges. The radius that reaches a tile of the scatter is taken to be {radius:.0f} pixels, so that the linear form's
programs end at once. Torch's small operations were counted on the CPU too, [torch_calls.csv](torch_calls.csv), by
`python benchmarks/gpu_torch_calls.py --out reports/gpu`.

## Totals

{totals}
Steps and pictures are those that the device could take; Python may be slower than it in handing over so many
launches.
"""
SCATTER = """Each form with all tiles and with its gradient, at {name}'s size, one radius everywhere; that of a hexagon
is its corners'.

{scatter}
From which radius on the linear form is the faster one, and stays so up to 64 pixels:

{crossings}"""
POINTS = """The preset `thinlens` draws a picture from {points} points of the lens, each as a picture of its own with a
blur for each Gaussian, and learns from their mean. A picture is what is drawn before loss and gradient; the scatter has
one sharp picture with its depth. {name} again, with the lists that it has without the Gaussians' blur.

{both}
"""
FIELDS = """A training step of a field with the presets' ranks, 8 and 16, and nine harmonics, on a cube of as many nodes
a side, whose rays learn as well, as those through a lens do. How many samples a ray has, and how they crowd in the
grid's cells, was measured on the CPU, [field_samples.csv](field_samples.csv), by
`python benchmarks/gpu_field_samples.py --out reports/gpu`: the built-in scene after 600 steps, {steps} steps a ray, of
which those in empty cells are left out. Below the sum stands what isn't in every step: the densities by which empty
cells are found, every {cells_every}nd step, and the features that DP-NeRF reads at {along} points of each ray, with
their gradient.

"""
STEREO = """The depth prior of one view: a sweep at three sizes of the picture, paths through the scores of the largest,
and the check against 32 other views. It is done once for each view, before training.

"""


@dataclass(frozen=True)
class Model:
    """All that the page is made of. sizes, fields: of training steps. count: of Triton kernels. points: a
    step that is drawn from points of the lens. forms: of the scatter. view: of stereo. times: by workload and GPU. The
    others are rows of the CSV files."""

    sizes: tuple[Sizes, ...]
    fields: tuple[FieldSizes, ...]
    count: int
    points: Task
    forms: tuple[Task, ...]
    view: Task
    times: dict[tuple[str, str], list[Time]]
    stages: Sequence[Row]
    totals: Sequence[Row]
    wholes: Sequence[Row]
    scatter: Sequence[Row]
    crossings: Sequence[Row]


def page(model: Model) -> str:
    """The whole page."""
    first, points, view = model.sizes[0].name, model.points.name, model.view.name
    seen = [one.name for one in model.fields]
    sections = [
        *((f"A training step: {one.name}", _stages(model, one.name)) for one in model.sizes),
        (
            "The scatter by radius",
            SCATTER.format(
                name=first, scatter=tables.scatter(model.scatter), crossings=tables.crossings(model.crossings)
            ),
        ),
        *((task.name, _stages(model, task.name)) for task in model.forms),
        (
            "Points of the lens",
            POINTS.format(points=LENS_POINTS, name=first.capitalize(), both=tables.points(points, first, model.wholes))
            + _stages(model, points),
        ),
        (
            "Radiance fields",
            FIELDS.format(steps=model.fields[0].steps, cells_every=CELLS_EVERY, along=ALONG)
            + tables.fields(model.fields, model.wholes),
        ),
        *((f"A training step: {name}", _stages(model, name)) for name in (seen[0], seen[-1])),
        (f"Stereo: {view}", STEREO + _stages(model, view)),
        (
            "What follows for the design",
            says.points_of(
                *says.gaussians(model.sizes, model.times, model.totals),
                says.scatter(model.scatter, model.crossings),
                says.lens_points(points, first, model.wholes),
                says.fields(seen, model.times, model.wholes),
                says.stereo(view, model.times, model.wholes),
            ),
        ),
        ("What is weakest in it", says.points_of(*says.WEAKEST)),
    ]
    head = INTRODUCTION.format(
        launch=1e6 * LAUNCH,
        wait=1e6 * WAIT,
        sort=SORT_SHARE,
        count=model.count,
        gaussians=tables.gaussians(model.sizes),
        radius=model.sizes[0].radius,
        totals=tables.totals(model.totals, f"{STEPS:,}".replace(",", " ")),
    )
    return "\n".join([head, *(f"## {title}\n\n{text}" for title, text in sections)])


def _stages(model: Model, workload: str) -> str:
    return tables.stages(workload, model.stages)
