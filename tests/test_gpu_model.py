"""The model of kernel times: loops of machine code, bytes and times by hand; more work never takes less time."""

from __future__ import annotations

import csv
import importlib
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.lens import ApertureShape

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))  # where scripts import what lies beside them
gpu_code, gpu_ops, gpu_pace, gpu_peaks, gpu_sass, gpu_times, gpu_work = map(
    importlib.import_module, ("gpu_code", "gpu_ops", "gpu_pace", "gpu_peaks", "gpu_sass", "gpu_times", "gpu_work")
)
gpu_scatter_windows, gpu_sizes, gpu_sizes_field, gpu_sizes_stereo = map(
    importlib.import_module, ("gpu_scatter_windows", "gpu_sizes", "gpu_sizes_field", "gpu_sizes_stereo")
)
sys.path.remove(str(ROOT / "benchmarks"))


def imported(name: str) -> Any:
    """A script that lies beside those above."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))


SIZES = gpu_sizes.Sizes("small", 10_000, 64, 48)
FIELD = gpu_sizes_field.FieldSizes("small", 512, 100)
VIEW = gpu_sizes_stereo.StereoSizes("small", 96, 64, 40, 3)
A100 = gpu_peaks.GPUS[0]
BEYOND_THE_END = """
.L_x_9:
        /*0900*/                   FADD R9, R9, R9 ;
        /*0910*/                   BRA `(.L_x_1) ;
"""


def code(*lines: str) -> str:
    """A listing as nvdisasm writes it, of instructions and labels (".L_x_0:")."""
    return "\n".join(
        line if line.startswith(".L") else f"        /*{16 * number:04x}*/                   {line} ;"
        for number, line in enumerate(lines)
    )


def sizes_of(text: str) -> list[tuple[int, int, int | None]]:
    """(instructions, those that a branch may skip, parent) of each part."""
    return [(len(part.instructions), sum(part.sometimes), part.parent) for part in gpu_sass.parts(text)]


# ---- loops ----


def test_code_without_a_loop_runs_once() -> None:
    assert sizes_of(code("MOV R1, R2", "FADD R1, R1, R1", "EXIT")) == [(3, 0, None)]


def test_a_loop_in_a_loop() -> None:
    text = code(
        "MOV R1, RZ",
        ".L_x_0:",
        "MOV R2, RZ",
        "MOV R3, RZ",
        ".L_x_1:",
        "FADD R4, R4, R2",
        "IADD3 R2, R2, 0x1, RZ",
        "@P0 BRA `(.L_x_1)",
        "IADD3 R1, R1, 0x1, RZ",
        "@P1 BRA `(.L_x_0)",
        "STG.E [R6.64], R4",
        "EXIT",
    )
    assert sizes_of(text) == [(3, 0, None), (4, 0, 0), (3, 0, 1)]


def test_two_loops_one_after_the_other() -> None:
    text = code(
        ".L_x_0:", "FADD R1, R1, R1", "@P0 BRA `(.L_x_0)",
        ".L_x_1:", "FMUL R1, R1, R1", "FMUL R2, R1, R1", "@P1 BRA `(.L_x_1)", "EXIT",
    )  # fmt: skip
    assert sizes_of(text) == [(1, 0, None), (2, 0, 0), (3, 0, 0)]


def test_what_a_branch_skips_in_a_loop_is_told_apart() -> None:
    text = code(
        ".L_x_0:", "LDG.E R1, [R2.64]", "@!P0 BRA `(.L_x_1)",
        "FADD R3, R3, R1", "FMUL R4, R3, R3", "FMUL R5, R3, R3",
        ".L_x_1:", "IADD3 R2, R2, 0x4, RZ", "@P1 BRA `(.L_x_0)", "EXIT",
    )  # fmt: skip
    assert sizes_of(text) == [(1, 0, None), (7, 3, 0)]


def test_a_branch_back_from_the_end_of_the_code_is_no_loop() -> None:
    text = code("@P0 BRA `(.L_x_9)", ".L_x_1:", "FADD R1, R1, R1", "EXIT") + BEYOND_THE_END
    assert sizes_of(text) == [(5, 2, None)]


def test_what_is_never_reached_is_left_out() -> None:
    text = code("BRA `(.L_x_1)", "FADD R9, R9, R9", ".L_x_1:", "EXIT", ".L_x_2:", "BRA `(.L_x_2)")
    assert sizes_of(text) == [(2, 0, None)]


def test_code_for_warps_whose_threads_went_apart_is_left_out() -> None:
    text = code("BRA.DIV UR4, `(.L_x_9)", ".L_x_1:", "FADD R1, R1, R1", "EXIT") + BEYOND_THE_END
    assert sizes_of(text) == [(3, 0, None)]


def test_what_a_branch_skips_in_a_program_is_told_apart() -> None:
    text = code("@P0 BRA `(.L_x_1)", "FADD R1, R1, R1", "FMUL R1, R1, R1", ".L_x_1:", "STG.E [R6.64], R4", "EXIT")
    assert sizes_of(text) == [(5, 2, None)]


def test_a_call_of_a_label_ends_a_loop() -> None:
    """The assembler leaves loops by calls that never return; a call of a subroutine comes back."""
    text = code(
        ".L_x_0:",
        "MOV R2, RZ",
        ".L_x_1:",
        "CALL.REL.NOINC `($__internal_0_$__cuda_sm20_sqrt_rn_f32_slowpath)",
        "FADD R1, R1, R1",
        "@P0 CALL.REL.NOINC `(.L_x_2)",
        "BRA `(.L_x_1)",
        ".L_x_2:",
        "@!P1 CALL.REL.NOINC `(.L_x_3)",
        "BRA `(.L_x_0)",
        ".L_x_3:",
        "STG.E [R6.64], R4",
        "EXIT",
    )
    assert sizes_of(text) == [(2, 0, None), (3, 0, 0), (4, 0, 1)]


def test_no_listing_at_all() -> None:
    with pytest.raises(ValueError, match="no instructions"):
        gpu_sass.parts("headers alone\n")


@pytest.mark.parametrize(
    ("count", "exact", "found"),
    [(11, True, (2, 3)), (8, True, (2, 0)), (8, False, (1.625, 1.5)), (1.0, False, (0.0, 1.0))],
)
def test_unrolled_loops(count: float, exact: bool, found: tuple[float, float]) -> None:
    """A loop that is unrolled four times, and the copy for what is left over."""
    assert (gpu_code.passes(count, 4, 4, exact), gpu_code.passes(count, 1, 4, exact)) == found


# ---- the pace of code ----


def instructions(*lines: str) -> Any:
    return gpu_sass.parts(code(*lines, "EXIT"))[0].instructions[:-1]


def test_each_instruction_takes_a_unit() -> None:
    lines = "FFMA R1, R2, R3, R4", "IADD3 R1, R1, R2, RZ", "MUFU.EX2 R5, R1", "LDG.E R6, [R8.64]", "BAR.SYNC 0x0"
    pace = gpu_pace.pace_of(instructions(*lines), loop=False, loads="l1")
    assert (pace.instructions, pace.fma, pace.alu, pace.special, pace.memory) == (5, 1, 1, 1, 1)


def test_a_warp_waits_for_its_operands() -> None:
    chain = instructions("FADD R1, R1, R2", "FADD R3, R1, R2", "FADD R4, R3, R2")
    apart = instructions("FADD R1, R8, R9", "FADD R3, R8, R9", "FADD R4, R8, R9")
    assert gpu_pace.pace_of(chain, loop=False, loads="l1").alone == 3 * gpu_pace.ARITHMETIC
    assert gpu_pace.pace_of(apart, loop=False, loads="l1").alone == 2 + gpu_pace.ARITHMETIC


def test_a_pass_ends_where_the_next_begins() -> None:
    """A sum that waits for itself takes four cycles a pass; three that don't, as many as there are instructions."""
    alone = gpu_pace.pace_of(instructions("FADD R1, R1, R2"), loop=True, loads="l1").alone
    three = instructions("FADD R1, R8, R9", "FADD R3, R8, R9", "FADD R4, R8, R9")
    assert (alone, gpu_pace.pace_of(three, loop=True, loads="l1").alone) == (4, 3)


def test_a_load_by_what_was_loaded_comes_from_l2_and_its_neighbour_with_it() -> None:
    lines = instructions(
        "LDG.E R4, [R2.64]",
        "LEA R6, P0, R4, R8, 0x6",
        "LDG.E R10, [R6.64]",
        "LDG.E R11, [R6.64+0x4]",
        "FADD R1, R10, R11",
    )
    l1, l2 = gpu_pace.NEAR["l1"], gpu_pace.NEAR["l2"]
    expected = l1 + gpu_pace.ARITHMETIC + l2 + gpu_pace.ARITHMETIC
    assert gpu_pace.pace_of(lines, loop=False, loads="l1").alone == expected


# ---- bytes and times ----


def kernel(name: str, variant: str = "") -> Any:
    return next(one for one in gpu_ops.kernels() if (one.name, one.variant) == (name, variant))


def test_bytes_of_the_tone_curve() -> None:
    """Each of 3 H W numbers of four bytes is read once and written once."""
    assert kernel("power").moved(SIZES, A100) == 64 * 48 * 3 * 4 * 2
    assert kernel("power").programs(SIZES) == 9


def test_records_that_do_not_fit_in_l2_are_read_for_every_tile() -> None:
    many = replace(SIZES, gaussians=10_000_000, intersections=3.0)
    records = imported("gpu_work_rasterize").records
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
    rows = [
        made(op="rasterize", kernel="blend_backward"),
        made(op="rasterize", kernel="blend_backward", loop=0, instructions=100),
        made(op="rasterize", kernel="blend_backward", loop=0, sometimes=True, instructions=1000),
    ]
    sizes = replace(SIZES, taken=0.25)
    length = sizes.pairs / sizes.tiles
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


MADE_BY = "3.9.0"  # the version of Triton that made code.csv
SIZES_OF = {
    **dict.fromkeys(("tone", "ssim", "mix", "rasterize", "rasterize_from_points"), SIZES),
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
    ops = sum(
        calls * gpu_times.predicted(op, SIZES, A100, backward=True)
        for op, calls in (("tone", 2), ("ssim", 1), ("scatter", 1), ("rasterize", 1), ("training", 1))
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
        (lambda: gpu_times.predicted("defocus", SIZES, A100), "op defocus: expected one of field, field_density"),
        (lambda: gpu_times.predicted("tone", SIZES, replace(A100, architecture=70)), "no code for sm_70"),
    ],
)
def test_what_there_is_no_prediction_of(call: Callable[[], float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


# ---- sizes of workloads ----


def test_windows_by_hand() -> None:
    """A disc of 2 pixels is followed 4 pixels far, in nine rows of two coarse windows each, from -16 and from 0."""
    found = gpu_scatter_windows.windows(2.0, 0)
    assert (found.rows, found.coarse) == (9, 18)
    # Up to 3.5 pixels away in rows -3 to 3: both windows of a row have a place that near, the others none.
    assert found.coarse_met == 14 / 18
    assert found.fine == 4 * 14 and found.fine_met == 14 / 56 and found.taps == 4 * 14


@settings(max_examples=40, deadline=None)
@given(radius=st.floats(0.0, 60.0), blades=st.sampled_from([0, 5, 6, 8]))
def test_windows_hold_every_rim(radius: float, blades: int) -> None:
    """Every place where a weight is neither 0 nor 1 is gone through by itself, and few are besides."""
    found = gpu_scatter_windows.windows(radius, blades)
    dy, dx = np.mgrid[-80:81, -80:81]
    own = np.hypot(dx, dy) / ApertureShape(blades=blades).radius_factor(np.arctan2(dy, dx))
    rim = (abs(own - radius) < gpu_scatter_windows.BAND - FLOAT64_VALUE) & (np.hypot(dx, dy) <= found.rows // 2)
    assert rim.sum() <= found.taps <= rim.sum() + 20 * found.rows
    assert found.fine % 4 == 0 and found.fine <= 4 * found.coarse


def test_levels_of_a_view() -> None:
    view = gpu_sizes_stereo.StereoSizes("view", 504, 378, 128, 4)
    found = gpu_sizes_stereo.levels(view)
    assert [(one.width, one.height, one.planes) for one in found] == [(126, 94, 33), (252, 189, 65), (504, 378, 128)]
    assert [(one.coarse_width, one.coarse_planes) for one in found] == [(0, 0), (126, 33), (252, 65)]
    # 64 MiB hold the sums of seven planes: 4 * 3 * 4 * 378 * 510 bytes each.
    assert (view.sweeps, view.together) == (19, 128 / 19)


def test_a_grid_is_read_once_at_most() -> None:
    assert FIELD.grid_nodes == 3 * 100 * 100 + 3 * 100
    assert FIELD.read(10, 8) == 4 * 8 * 3 * 6 * 10
    assert FIELD.read(1e9, 8) == 4 * 8 * FIELD.grid_nodes


def test_passes_along_a_ray() -> None:
    """64 steps: four blocks of 16 if all are samples; 24 samples are one and a half and half of the last."""
    assert FIELD.along(24, 16) == 1.5 + 15 / 32
    assert FIELD.along(64, 16) == FIELD.all_along(16) == 4


def test_passes_at_a_grids_nodes() -> None:
    """Three samples in one cell of a plane of 3 x 3 nodes: its four nodes are the corner's, in two programs of four."""
    samples = imported("gpu_field_samples")
    cells = np.zeros((3, 3), int)
    passes = samples.plane_passes(cells, 3, 4, 2)
    # Nodes 0, 1, 3 and 4 of each plane of nine meet the cell, two samples a pass.
    met = np.array([n % 9 in (0, 1, 3, 4) for n in range(27)] + [False])
    assert passes.tolist() == [2 if four.any() else 0 for four in met.reshape(-1, 4)]
    assert samples.plane_passes(cells, 3, 1, 8).tolist() == [int(n % 9 in (0, 1, 3, 4)) for n in range(27)]
    # Two cells a line, four programs each: three of them have one of the first cell's samples.
    assert samples.line_passes(cells, 3, 128).tolist() == [1, 1, 1, 0, 0, 0, 0, 0] * 3


def test_what_counts_as_a_launch_of_torch() -> None:
    """Views don't, nor does a sum that is read to see whether values are finite."""
    with imported("gpu_torch_calls").Calls() as calls:
        values = torch.ones(6)
        assert float((2 * values).view(2, 3).t().sum()) == 12
    assert calls.count == 2  # ones and product


# ---- tables ----


@pytest.mark.parametrize(
    "task", [gpu_ops.training_step(SIZES), gpu_ops.field_step(FIELD, FIELD), gpu_ops.stereo_view(VIEW)]
)
def test_stages_add_up_to_the_whole(task: Any) -> None:
    times = {(task.name, gpu.name): gpu_times.task_times(task, gpu) for gpu in gpu_peaks.GPUS}
    rows = [row for row in imported("gpu_model_rows").stage_rows(task, times) if row["gpu"] == A100.name]
    stages = {row["stage"]: row["percent"] for row in rows if row["kernel"] == "all"}
    assert sum(stages[stage] for stage in task.stages) == pytest.approx(100)
    assert stages["all"] == pytest.approx(100)
    assert [row["stage"] for row in rows if row["kernel"] == "all"] == [*task.stages, "all", *task.beside]
    assert "mixed" not in {row["kernel"] for row in rows}


def test_where_the_linear_form_begins_to_win() -> None:
    """From the found radius on it is the faster one, and a pixel before it isn't."""
    rows = imported("gpu_model_rows")
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


# ---- footprints on the CPU ----


def record(**values: float) -> np.ndarray:
    """(1, 16), a Gaussian's record with an ellipse in pixels: its centre, its half axes along x and y, opacity 1."""
    layout = imported("gpu_footprints").layout
    made = np.zeros((1, layout.RECORD))
    made[0, [layout.MX, layout.MY]] = values["x"], values["y"]
    # The exponent is -(dx / a)**2 - (dy / b)**2, and counts down to -1.
    made[0, [layout.L11, layout.L22, layout.LIMIT]] = 1 / values["a"], 1 / values["b"], -1.0
    return made


CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))


@settings(max_examples=50, deadline=None)
@given(x=st.floats(-20, 84), y=st.floats(-20, 68), a=st.floats(0.3, 40), b=st.floats(0.3, 40))
def test_tiles_that_an_ellipse_meets(x: float, y: float, a: float, b: float) -> None:
    """All tiles with a pixel's centre in the ellipse are listed, and none that the box around it doesn't reach."""
    footprints = imported("gpu_footprints")
    column, row = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    inside = ((column - x) / a) ** 2 + ((row - y) / b) ** 2 <= 1 - FLOAT64_VALUE
    boxed = (abs(column - x) <= a + FLOAT64_VALUE) & (abs(row - y) <= b + FLOAT64_VALUE)
    assume(boxed.any())  # others are no candidates
    for k in range(3):
        first, many = footprints.columns_met(record(x=x, y=y, a=a, b=b), k, CAMERA)
        listed = set(range(int(first[0]), int(first[0] + many[0])))
        met, box = (
            {c for c in range(4) if mask[16 * k : 16 * k + 16, 16 * c : 16 * c + 16].any()} for mask in (inside, boxed)
        )
        assert met <= listed <= box


def test_a_tile_is_followed_until_it_is_opaque() -> None:
    """Wide Gaussians of alpha 0.99 leave less than 1e-4 behind the third; it is noticed after sixteen."""
    footprints = imported("gpu_footprints")
    wide = record(x=8.0, y=8.0, a=1e4, b=1e4)
    assert footprints.follow(wide, [0] * 40, 0, 4, CAMERA) == (16, 3)
    assert footprints.follow(wide, [0] * 2, 0, 4, CAMERA) == (2, 2)


def test_a_gaussian_that_colours_no_pixel_is_looked_at() -> None:
    beyond = record(x=40.0, y=8.0, a=2.0, b=2.0)
    assert imported("gpu_footprints").follow(beyond, [0], 0, 4, CAMERA) == (1, 0)


# ---- the kernels' own code ----


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


def test_loops_in_each_other_are_told_apart() -> None:
    """The linear scatter's loops over fine and coarse windows have the same instructions."""
    for gpu in gpu_peaks.GPUS:
        rows = gpu_times.code_of(kernel("gather_windows"), gpu.architecture, None)
        assert {row.loop for row in rows} == {-1, 0, 1, 2, 3}
        # A window's sum and its parts may be skipped, single offsets not.
        skipped = {row.loop for row in rows if row.sometimes}
        assert {1, 2} <= skipped and 0 not in skipped


COMPILE = """
import sys
from pathlib import Path
import gpu_code
from gpu_ops import kernels
kernel = next(one for one in kernels() if one.name == "tile_window")
launch = {
    "module": "dofbench.kernels.scatter.gpu_direct",
    "function": "tile_window",
    "signature": [("reach", "*fp32"), ("window", "*i32"), ("rows", "i32"), ("columns", "i32"),
                  ("TILE_Y", "constexpr"), ("TILE_X", "constexpr"), ("BLOCK", "constexpr")],
    "constants": [("TILE_Y", 8), ("TILE_X", 32), ("BLOCK", 512)],
    "warps": 4,
}
gpu_code.write(Path(sys.argv[1]), gpu_code.code_of(kernel, launch, 80))
"""


def test_compiled_code_is_that_of_the_report(tmp_path: Path) -> None:
    """One kernel with a loop, compiled anew in a process in which Triton doesn't interpret kernels."""
    triton = pytest.importorskip("triton", reason="needs Triton, the extra gpu")
    if triton.__version__ != MADE_BY:
        pytest.skip(f"the report's code was made by Triton {MADE_BY}, here is {triton.__version__}")
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    environment["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "benchmarks")))
    command = [sys.executable, "-c", COMPILE, str(tmp_path / "code.csv")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    kept = gpu_code.read(gpu_times.REPORT / "code.csv")
    found = gpu_code.read(tmp_path / "code.csv")
    assert found == [row for row in kept if (row.kernel, row.architecture) == ("tile_window", 80)]
    assert {row.loop for row in found} == {-1, 0}
