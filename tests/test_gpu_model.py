"""The model of kernel times: bytes and times by hand, more work never takes less time, and no kernel is missing."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from benchmark_scripts import script
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

gpu_code, gpu_model_rows, gpu_ops, gpu_peaks, gpu_times, gpu_work = map(
    script, ("gpu_code", "gpu_model_rows", "gpu_ops", "gpu_peaks", "gpu_times", "gpu_work")
)
gpu_sizes, gpu_sizes_field, gpu_sizes_stereo = map(script, ("gpu_sizes", "gpu_sizes_field", "gpu_sizes_stereo"))

SIZES = gpu_sizes.Sizes("small", 10_000, 64, 48)
FIELD = gpu_sizes_field.FieldSizes("small", 512, 100)
VIEW = gpu_sizes_stereo.StereoSizes("small", 96, 64, 40, 3)
A100 = gpu_peaks.GPUS[0]


# ---- bytes and times ----


def kernel(name: str, variant: str = "") -> Any:
    return next(one for one in gpu_ops.kernels() if (one.name, one.variant) == (name, variant))


def test_bytes_of_the_tone_curve() -> None:
    """Each of 3 H W numbers of four bytes is read once and written once."""
    assert kernel("power").moved(SIZES, A100) == 64 * 48 * 3 * 4 * 2
    assert kernel("power").programs(SIZES) == 9


def test_records_that_do_not_fit_in_l2_are_read_for_every_tile() -> None:
    many = replace(SIZES, gaussians=10_000_000, intersections=3.0)
    records = script("gpu_work_rasterize").records
    small, large = (records(one, A100) for one in (SIZES, many))
    assert (small, large) == (64 * 10_000, 64 * 30_000_000)


@pytest.mark.parametrize(("stride", "loaded", "stored"), [(4, 0, 0), (16, 0, 3), (64, 3, 15), (180, 7, 31)])
def test_numbers_that_lie_apart(stride: int, loaded: int, stored: int) -> None:
    """32 numbers of four bytes touch one line of 128 bytes side by side, up to 32 lines apart; four are looked up a
    cycle, one is stored."""
    assert (gpu_work.loaded(2, stride), gpu_work.stored(2, stride)) == (2 * loaded, 2 * stored)


def test_bytes_of_a_sort() -> None:
    """Keys of two bytes with places of eight: both written once or more, and read and written in two passes."""
    assert gpu_work.sorted_bytes(1000, 2) == 1000 * (2 + 2 * 2 * (2 + 8) + 8)


def test_places_of_the_direct_scatter() -> None:
    """They hold the disc that is followed, and are few more."""
    for radius in (0.0, 3.5, 20.0):
        one = replace(SIZES, radius=radius)
        disc = math.pi * one.reach**2
        assert disc < one.offsets < disc + 9 * (one.reach + 1)


def made(**changes: Any) -> Any:
    """A kernel of one warp in each program whose code is given."""
    row = {
        "op": "scatter", "kernel": "pack_sources", "variant": "", "architecture": 80, "warps": 1, "occupancy": 0.5,
        "loop": -1, "unrolled": 1, "sometimes": False, "instructions": 0, "fma": 0, "double": 0, "alu": 0, "special": 0,
        "memory": 0, "alone": 0,
    }  # fmt: skip
    return gpu_code.Code(**{**row, **changes})


@pytest.mark.parametrize(
    ("changes", "bound", "cycles"),
    [
        ({"instructions": 4e6}, "issue", 4e6),
        ({"instructions": 4e6, "fma": 4e6}, "fma", 8e6),
        ({"instructions": 4e6, "special": 1e6}, "special", 8e6),
        ({"instructions": 4e6, "double": 2e6}, "double", 8e6),
        ({"instructions": 4e6, "alone": 9e6}, "latency", 9e6),
    ],
)
def test_the_slowest_unit_bounds_a_kernel(changes: dict[str, float], bound: str, cycles: float) -> None:
    """432 programs of one warp: one for each scheduler of an A100, fewer than it has room for."""
    sizes = replace(SIZES, width=512 * 432, height=1)
    time = gpu_times.kernel_time(kernel("pack_sources"), gpu_ops.Call("scatter", sizes), A100, [made(**changes)])
    assert time.bound == bound
    assert time.seconds == pytest.approx(cycles / A100.clock + gpu_peaks.LAUNCH)


def test_bandwidth_bounds_a_kernel() -> None:
    call = gpu_ops.Call("scatter", replace(SIZES, width=4096, height=4096))
    time = gpu_times.kernel_time(kernel("pack_sources"), call, A100, [made(instructions=1)])
    assert time.bound == "memory"
    assert time.busy == pytest.approx(4096 * 4096 * 36 / A100.bandwidth)


def test_a_branch_that_is_rarely_taken_costs_its_share() -> None:
    """A program goes through 64 Gaussians of a tile's list, or what is left for the last one, half of it on average."""
    rows = [
        made(op="rasterize", kernel="blend_backward"),
        made(op="rasterize", kernel="blend_backward", loop=0, instructions=100),
        made(op="rasterize", kernel="blend_backward", loop=0, sometimes=True, instructions=1000),
    ]
    sizes = replace(SIZES, taken=0.25)
    length = sizes.pairs / (sizes.pairs / 64 + sizes.tiles / 2)
    each = gpu_times.warp_pace(kernel("blend_backward"), rows, sizes)
    assert each.instructions == pytest.approx(length * (100 + 0.25 * 1000))


def test_the_longest_program_has_to_end() -> None:
    """Of a kernel whose warps wait: as long as the longest one, what it does once counted once."""
    rows = [
        made(op="rasterize", kernel="blend", alone=10_000),
        made(op="rasterize", kernel="blend", loop=0, alone=1_000_000),
        made(op="rasterize", kernel="blend", loop=1, alone=0),
    ]
    sizes = replace(SIZES, gaussians=10, longest_list=3.0)
    time = gpu_times.kernel_time(kernel("blend"), gpu_ops.Call("rasterize", sizes), A100, rows)
    assert time.bound == "latency"
    assert time.busy * A100.clock == pytest.approx(10_000 + 3 * sizes.pairs / sizes.tiles * 1_000_000)


def test_programs_that_find_nothing_skip_most() -> None:
    rows = [
        made(op="field", kernel="add_to_planes", variant="density", instructions=100),
        made(op="field", kernel="add_to_planes", variant="density", instructions=1000, sometimes=True),
        made(op="field", kernel="add_to_planes", variant="density", loop=0),
    ]
    one = kernel("add_to_planes", "density")
    assert gpu_times.warp_pace(one, rows, replace(FIELD, planes_density_some=0.25)).instructions == 350


SIZES_OF = {
    **dict.fromkeys(("tone", "ssim", "mix", "surface", "known_depth", "colours"), SIZES),
    **dict.fromkeys(("rasterize", "rasterize_from_points"), SIZES),
    **dict.fromkeys((name for name in gpu_ops.OPS if name.startswith("scatter")), SIZES),
    **dict.fromkeys((name for name in gpu_ops.OPS if name.startswith("field")), FIELD),
    **dict.fromkeys((name for name in gpu_ops.OPS if name.startswith("stereo")), VIEW),
}
GROWING = {
    gpu_sizes.Sizes: (
        "gaussians", "width", "height", "intersections", "widest_rows", "most_intersections", "longest_list", "radius",
        "points",
    ),
    gpu_sizes_field.FieldSizes: (
        "rays", "samples", "looked_at", "lit", "nodes", "planes_density", "planes_density_longest", "planes_colour",
        "lines_density", "lines_colour_longest",
    ),
    gpu_sizes_stereo.StereoSizes: ("width", "height", "planes", "sources"),
}  # fmt: skip


def test_every_op_has_sizes() -> None:
    assert SIZES_OF.keys() == {name for name in gpu_ops.OPS if not name.startswith("training")}


@settings(max_examples=100, deadline=None)
@given(data=st.data(), gpu=st.sampled_from(gpu_peaks.GPUS), factor=st.floats(1.0, 20.0))
def test_more_work_never_takes_less_time(data: st.DataObject, gpu: Any, factor: float) -> None:
    op = data.draw(st.sampled_from(sorted(SIZES_OF)))
    sizes = SIZES_OF[op]
    what = data.draw(st.sampled_from(GROWING[type(sizes)]))
    # In a larger picture the same Gaussians' lists are shorter and shared by more programs, so that isn't more work,
    # nor are the longest list and the passes of a longer mean.
    assume(not op.startswith("rasterize") or what not in ("width", "height"))
    if isinstance(sizes, gpu_sizes.Sizes):
        sizes = replace(sizes, gaussians=data.draw(st.integers(1_000, 3_000_000)))
    before = getattr(sizes, what)
    more = replace(sizes, **{what: type(before)(before * factor)})
    if f"{what}_longest" in vars(sizes):
        more = replace(more, **{f"{what}_longest": factor * getattr(sizes, f"{what}_longest")})
    # Where a field's cells become crowded, programs of another size sum at its nodes.
    assume(not op.startswith("field") or more.crowded == sizes.crowded)
    for backward in (False, True):
        times = [gpu_times.predicted(op, one, gpu, backward=backward) for one in (sizes, more)]
        # Planes are swept in launches of equal size, so that one more may fill the GPU better.
        assert times[1] >= times[0] * (0.9 if op == "stereo" else 1 - FLOAT64_VALUE)


@pytest.mark.parametrize("op", [op for op in SIZES_OF if any(one.backward for one in gpu_ops.OPS[op].kernels)])
def test_a_gradient_takes_time(op: str) -> None:
    with_gradient = gpu_times.predicted(op, SIZES_OF[op], A100, backward=True)
    assert with_gradient > gpu_times.predicted(op, SIZES_OF[op], A100)


def test_the_step_is_made_of_its_parts() -> None:
    """The ops' calls in a step, and what torch does besides; `mix` isn't among its stages."""
    task = gpu_ops.training_step(SIZES)
    once = "surface", "scatter", "rasterize", "colours", "ssim", "known_depth", "training"
    ops = sum(
        calls * gpu_times.predicted(op, SIZES, A100, backward=True)
        for op, calls in (("tone", 2), *((name, 1) for name in once))
    )
    times = gpu_times.task_times(task, A100)
    assert sum(time.seconds for time in times if time.stage in task.stages) == pytest.approx(ops)
    assert {time.stage for time in times} - set(task.stages) == {"mix"}


def test_a_task_has_a_row_for_each_kernel_and_stage() -> None:
    """A view of stereo sweeps three sizes of the picture: their times are one row, bound by what the longest is."""
    task = gpu_ops.stereo_view(VIEW)
    times = {time.label: time for time in gpu_times.task_times(task, A100)}
    each = [
        next(time for time in gpu_times.call_times(call, A100, None) if time.kernel == "sum_down")
        for call in task.calls
        if call.op == "stereo"
    ]
    assert len(each) == 3
    assert times["sum_down"].seconds == pytest.approx(sum(time.seconds for time in each))
    assert times["sum_down"].launches == sum(time.launches for time in each)
    assert times["find_returns"].launches == gpu_sizes_stereo.CHECKED


def test_points_of_the_lens_are_pictures_of_their_own() -> None:
    many = replace(SIZES, points=5)
    assert (many.tiles, many.pairs, many.pixels) == (5 * SIZES.tiles, 5 * SIZES.pairs, SIZES.pixels)
    assert many.followed / many.tiles == SIZES.followed / SIZES.tiles
    drawn = {time.label: time for time in gpu_times.task_times(gpu_ops.points_step(many), A100)}
    assert drawn["power"].bytes == (5 + 1) * 8 * SIZES.numbers
    assert "blend (points)" in drawn and "blend" not in drawn


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: gpu_times.predicted("defocus", SIZES, A100), "op defocus: expected one of colours, field"),
        (lambda: gpu_times.predicted("tone", SIZES, replace(A100, architecture=70)), "no code for sm_70"),
    ],
)
def test_what_there_is_no_prediction_of(call: Callable[[], float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


# ---- tables ----


@pytest.mark.parametrize(
    "task", [gpu_ops.training_step(SIZES), gpu_ops.field_step(FIELD, FIELD), gpu_ops.stereo_view(VIEW)]
)
def test_stages_add_up_to_the_whole(task: Any) -> None:
    times = {(task.name, gpu.name): gpu_times.task_times(task, gpu) for gpu in gpu_peaks.GPUS}
    rows = [row for row in gpu_model_rows.stage_rows(task, times) if row["gpu"] == A100.name]
    stages = {row["stage"]: row["percent"] for row in rows if row["kernel"] == "all"}
    assert sum(stages[stage] for stage in task.stages) == pytest.approx(100)
    assert stages["all"] == pytest.approx(100)
    assert [row["stage"] for row in rows if row["kernel"] == "all"] == [*task.stages, "all", *task.beside]
    assert "mixed" not in {row["kernel"] for row in rows}


def test_where_the_linear_form_begins_to_win() -> None:
    """From the found radius on it is the faster one, and a pixel before it isn't."""
    rows = gpu_model_rows
    for row in rows.crossing_rows(SIZES, gpu_times._kept()):
        gpu = next(one for one in gpu_peaks.GPUS if one.name == row["gpu"])
        for radius, wins in ((row["both_px"], True), (row["both_px"] - 1, False)):
            times = [
                gpu_times.predicted(
                    f"scatter_{form}{rows.APERTURES[row['aperture']]}",
                    replace(SIZES, radius=float(radius)),
                    gpu,
                    backward=True,
                )
                for form in ("direct", "linear")
            ]
            assert (times[1] < times[0]) == wins


# ---- no kernel is missing ----


def test_every_kernel_that_training_launches_is_in_the_model() -> None:
    """kernels.csv has all that were launched through every backend."""
    with (gpu_times.REPORT / "kernels.csv").open(encoding="utf-8") as stream:
        launched = {(row["op"], row["kernel"]) for row in csv.DictReader(stream)}
    assert launched == {(one.op, one.name) for one in gpu_ops.kernels()}


def test_every_kernel_has_code_for_every_gpu() -> None:
    rows = gpu_code.read(gpu_times.REPORT / "code.csv")
    known = {(row.op, row.kernel, row.variant, row.architecture) for row in rows}
    assert known == {(*one.code, gpu.architecture) for one in gpu_ops.kernels() for gpu in gpu_peaks.GPUS}


def test_every_kernel_is_timed() -> None:
    """A task, or one of the forms of the scatter, calls each."""
    tasks = (
        gpu_ops.training_step(SIZES),
        gpu_ops.points_step(replace(SIZES, points=5)),
        *gpu_ops.scatter_forms(SIZES),
        gpu_ops.field_step(FIELD, FIELD),
        gpu_ops.stereo_view(VIEW),
    )
    called = {one.code for task in tasks for call in task.calls for one in gpu_ops.OPS[call.op].kernels}
    assert called == {one.code for one in gpu_ops.kernels()}
