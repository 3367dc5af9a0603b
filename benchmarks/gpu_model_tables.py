"""The tables of the model's page, as Markdown, from the rows of its CSV files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gpu_peaks import GPUS
from gpu_sizes import Sizes
from gpu_sizes_field import FieldSizes

Row = Mapping[str, object]
_NAMES = [gpu.name for gpu in GPUS]


def table(head: Sequence[str], rows: Sequence[Sequence[object]], left: int) -> str:
    """A table; the first `left` columns are words."""
    marks = [":---"] * left + ["---:"] * (len(head) - left)
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in (head, marks, *rows)) + "\n"


def gaussians(sizes: Sequence[Sizes]) -> str:
    """The workloads with Gaussians."""
    head = ("workload", "Gaussians", "picture", "for each pixel", "visible", "tiles of a visible one",
            "Gaussians of a tile", "taken")  # fmt: skip
    rows = [
        (
            one.name, one.gaussians, f"{one.width} x {one.height}", f"{one.gaussians / one.pixels:.1f}",
            f"{one.visible:.0%}", f"{one.intersections:.2f}", f"{one.pairs / one.tiles:.0f}",
            f"{one.looked_at * one.taken:.1%}",
        )
        for one in sizes
    ]  # fmt: skip
    return table(head, rows, 1)


def totals(rows: Sequence[Row], steps: str) -> str:
    """What training steps of Gaussians take altogether."""
    head = ("workload", "GPU", "step [ms]", "steps a second", f"seconds for {steps} steps", "pictures a second",
            "with a lens", "launches", "of the step [%]", "twice the intersections [ms]")  # fmt: skip
    cells = [
        (
            row["workload"], row["gpu"], f"{row['step_ms']:.2f}", f"{row['steps_per_second']:.0f}",
            f"{row['seconds_of_training']:.0f}", f"{row['pictures_per_second']:.0f}",
            f"{row['pictures_per_second_lens']:.0f}", f"{row['launches']:.0f}", f"{row['launch_percent']:.0f}",
            f"{row['twice_the_intersections_ms']:.2f}",
        )
        for row in rows
    ]  # fmt: skip
    return table(head, cells, 2)


def fields(sizes: Sequence[FieldSizes], wholes: Sequence[Row]) -> str:
    """What training steps of fields take altogether, and of how many samples."""
    head = ("rays", "nodes a side", "samples of a ray", "that light reaches", "with a colour",
            *(f"{name} [ms]" for name in _NAMES), "launches")  # fmt: skip
    rows = []
    for one in sizes:
        same = of(wholes, workload=one.name)
        counts = f"{one.samples:.1f}", f"{one.looked_at:.1f}", f"{one.lit:.1f}"
        times = [f"{row['milliseconds']:.2f}" for row in same]
        rows.append((one.rays, one.nodes, *counts, *times, f"{same[0]['launches']:.0f}"))
    return table(head, rows, 0)


def points(name: str, with_scatter: str, wholes: Sequence[Row]) -> str:
    """A picture and a training step from points of the lens, beside those with the scatter."""
    rows = []
    for gpu in _NAMES:
        one, other = (of(wholes, workload=workload, gpu=gpu)[0] for workload in (name, with_scatter))
        both = [f"{row[column]:.2f}" for column in ("forward_ms", "milliseconds") for row in (one, other)]
        rows.append((gpu, *both))
    ways = "from points [ms]", "with the scatter [ms]"
    head = ("GPU", *(f"{what} {way}" for what in ("picture", "step") for way in ways))
    return table(head, rows, 1)


def stages(name: str, rows: Sequence[Row]) -> str:
    """The table of one workload: each stage, and the kernels in it."""
    lines = []
    same = of(rows, workload=name)
    for first in of(same, gpu=_NAMES[0]):
        found = of(same, stage=first["stage"], kernel=first["kernel"])
        cells = [cell for row in found for cell in (f"{row['milliseconds']:.3f}", row["bound"])]
        names = (f"**{first['stage']}**", "") if first["kernel"] == "all" else ("", first["kernel"])
        lines.append((*names, *cells))
    head = ("stage", "kernel", *(word for name in _NAMES for word in (f"{name} [ms]", "bound")))
    marks = "| :--- | :--- |" + " ---: | :--- |" * len(_NAMES)
    top, _, *rest = table(head, lines, 2).split("\n")
    return "\n".join([top, marks, *rest])


def scatter(rows: Sequence[Row]) -> str:
    """Both forms of the scatter by aperture and radius."""
    cells = []
    for first in of(rows, gpu=_NAMES[0]):
        same = of(rows, aperture=first["aperture"], radius=first["radius"])
        times = [f"{row[f'{form}_both_ms']:.3f}" for row in same for form in ("direct", "linear")]
        cells.append((first["aperture"], f"{first['radius']:.0f}", first["places"], *times))
    forms = [f"{name}, {form} [ms]" for name in _NAMES for form in ("direct", "linear")]
    return table(("aperture", "radius [px]", "places for a pixel", *forms), cells, 1)


def crossings(rows: Sequence[Row]) -> str:
    """From which radius on the linear form is the faster one."""
    ways = [("forward", "forward_px"), ("gradient alone", "backward_px"), ("both", "both_px")]
    cells = [
        (aperture, way, *("never" if row[column] is None else row[column] for row in of(rows, aperture=aperture)))
        for aperture in dict.fromkeys(row["aperture"] for row in rows)
        for way, column in ways
    ]
    return table(("aperture", "of the call", *(f"{name} [px]" for name in _NAMES)), cells, 2)


def of(rows: Sequence[Row], **wanted: object) -> list[Row]:
    """The rows with these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]
