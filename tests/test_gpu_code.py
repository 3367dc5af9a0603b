"""How machine code is read for the model of kernel times: its loops, its pace, and that the report's is what kernels
compile to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmark_scripts import FOLDER, script

gpu_code, gpu_ops, gpu_pace, gpu_peaks, gpu_sass, gpu_times = map(
    script, ("gpu_code", "gpu_ops", "gpu_pace", "gpu_peaks", "gpu_sass", "gpu_times")
)

MADE_BY = "3.9.0"  # the version of Triton that made code.csv
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


# ---- the kernels' own code ----


def test_loops_in_each_other_are_told_apart() -> None:
    """The linear scatter's loops over fine and coarse windows have the same instructions."""
    discs = next(one for one in gpu_ops.kernels() if (one.name, one.variant) == ("gather_windows", ""))
    for gpu in gpu_peaks.GPUS:
        rows = gpu_times.code_of(discs, gpu.architecture, None)
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
    environment["PYTHONPATH"] = os.pathsep.join((str(FOLDER.parent), str(FOLDER)))
    command = [sys.executable, "-c", COMPILE, str(tmp_path / "code.csv")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    kept = gpu_code.read(gpu_times.REPORT / "code.csv")
    found = gpu_code.read(tmp_path / "code.csv")
    assert found == [row for row in kept if (row.kernel, row.architecture) == ("tile_window", 80)]
    assert {row.loop for row in found} == {-1, 0}
