"""A model of how long each GPU kernel takes on GPUs that nobody here has: model.csv and its tables, and model.md.

    python benchmarks/gpu_model.py --out reports/gpu

A kernel takes as long as the slowest of these: its bytes at the memory's published bandwidth; its warp instructions at
the published rates of the multiprocessors' units; and one warp's way through the program, waiting for its operands, as
often as the multiprocessors are filled with warps (`gpu_times.py`). Instructions are counted in the machine code that
Triton's assembler makes for each GPU (`gpu_sass.py`, `gpu_pace.py`, `gpu_code.py`), their loops by the sizes of the
workload (`gpu_sizes.py` and those named alike). What each op does is in `gpu_work.py` and the modules named alike; what
torch does itself is bound by memory or launches. `gpu_ops.py` puts ops together to training steps. Peak figures and
their sources: `gpu_peaks.py`. Nothing is run on a GPU.

Another script compares what it measures: `gpu_times.predicted("scatter", sizes, gpu, backward=True)`, seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import gpu_code
import gpu_model_rows as rows
import tyro
from gpu_model_page import Model, page
from gpu_ops import field_step, kernels, points_step, scatter_forms, stereo_view, training_step
from gpu_peaks import GPUS
from gpu_sizes import from_points, workloads
from gpu_sizes_field import field_workloads
from gpu_sizes_stereo import StereoSizes
from gpu_times import Time, task_times

from dofbench.core.files import write_text
from dofbench.reporting.csv_writer import write_csv

COLUMNS = (
    "workload", "gpu", "op", "kernel", "variant", "stage", "backward", "bytes", "warp_instructions", "launches",
    "seconds", "bound", "occupancy",
)  # fmt: skip
FORMS_AT = 24.0  # pixels, at which the kernels of the scatter's forms are shown
VIEW = StereoSizes("504 x 378, 128 planes, 4 other views", 504, 378, 128, 4)


@dataclass(frozen=True)
class Settings:
    """Where the tables are."""

    out: Path
    """Folder for model.csv and what belongs to it; footprints.csv, torch_calls.csv and field_samples.csv are there
    already."""
    compile: bool = True
    """Compile the kernels again; otherwise their instructions come from the folder's code.csv."""


def main(settings: Settings) -> None:
    """Write all tables and the page."""
    out = settings.out
    if settings.compile:
        gpu_code.write(out / "code.csv", gpu_code.compile_all(sorted({gpu.architecture for gpu in GPUS})))
    codes = gpu_code.read(out / "code.csv")
    sizes, fields = workloads(out), field_workloads(out)
    steps = tuple(map(training_step, sizes))
    points, seen, view = (
        points_step(from_points(sizes[0], out)),
        tuple(map(field_step, fields, field_workloads(out, "points"))),
        stereo_view(VIEW),
    )
    forms = scatter_forms(replace(sizes[0], radius=FORMS_AT))
    tasks = (*steps, points, *forms, *seen, view)
    times = {(task.name, gpu.name): task_times(task, gpu, codes) for task in tasks for gpu in GPUS}
    model = Model(
        sizes=sizes,
        fields=fields,
        count=len({(one.op, one.name) for one in kernels()}),
        points=points,
        forms=forms,
        view=view,
        times=times,
        stages=[row for task in tasks for row in rows.stage_rows(task, times)],
        totals=[rows.total_row(one, gpu, times[one.name, gpu.name], codes) for one in sizes for gpu in GPUS],
        wholes=[rows.task_row(task, gpu, times[task.name, gpu.name]) for task in tasks for gpu in GPUS],
        scatter=list(rows.scatter_rows(sizes[0], codes)),
        crossings=list(rows.crossing_rows(sizes[0], codes)),
    )
    write_csv(out / "model.csv", COLUMNS, kernel_rows(times))
    for name, columns, table in (
        ("stages", rows.STAGE_COLUMNS, model.stages),
        ("totals", rows.TOTAL_COLUMNS, model.totals),
        ("tasks", rows.TASK_COLUMNS, model.wholes),
        ("scatter", rows.SCATTER_COLUMNS, model.scatter),
        ("crossings", rows.CROSSING_COLUMNS, model.crossings),
    ):
        write_csv(out / f"model_{name}.csv", columns, table)
    write_text(out / "model.md", page(model))


def kernel_rows(times: Mapping[tuple[str, str], Sequence[Time]]) -> Iterator[dict[str, object]]:
    """The rows of model.csv."""
    for (workload, gpu), many in times.items():
        for time in many:
            row = {name: getattr(time, name) for name in COLUMNS if hasattr(time, name)}
            row["occupancy"] = None if time.occupancy != time.occupancy else time.occupancy
            yield {"workload": workload, "gpu": gpu, **row}


if __name__ == "__main__":
    main(tyro.cli(Settings))
