"""The machine code of each kernel of `gpu_ops.py` as numbers, and code.csv, which keeps them: so a prediction needs
neither Triton nor an assembler.

A row is a part of a kernel: what runs once in a program, a pass of a loop, or the part of a pass that a branch skips.
"""

from __future__ import annotations

import csv
import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from gpu_kernels import binary_of, compiled, launches
from gpu_ops import kernels
from gpu_pace import Pace, pace_of
from gpu_sass import Part, parts
from gpu_work import Kernel

from dofbench.reporting.csv_writer import write_csv


@dataclass(frozen=True)
class Code:
    """A part of a kernel. variant: as in `gpu_work.Kernel`. warps: of a program. occupancy: 0 to 1. loop: which of
    `Kernel.loops`, -1 for what runs once. unrolled: passes of the loop in one pass of the code. sometimes: whether a
    branch may skip it. The rest: see `gpu_pace.Pace`."""

    op: str
    kernel: str
    variant: str
    architecture: int
    warps: int
    occupancy: float
    loop: int
    unrolled: int
    sometimes: bool
    instructions: float
    fma: float
    double: float
    alu: float
    special: float
    memory: float
    alone: float

    @property
    def pace(self) -> Pace:
        """What the part takes of a multiprocessor, for each warp and pass."""
        return Pace(self.instructions, self.fma, self.double, self.alu, self.special, self.memory, self.alone)


def read(file: Path) -> list[Code]:
    """The rows of code.csv."""
    kinds = {"op": str, "kernel": str, "variant": str, "architecture": int, "warps": int, "loop": int, "unrolled": int}
    with file.open(encoding="utf-8") as stream:
        return [
            Code(
                **{
                    key: kinds.get(key, float)(value) if key != "sometimes" else value == "True"
                    for key, value in row.items()
                }
            )
            for row in csv.DictReader(stream)
        ]


def write(file: Path, rows: Iterable[Code]) -> None:
    """Write code.csv."""
    names = tuple(field.name for field in fields(Code))
    write_csv(file, names, [{name: getattr(row, name) for name in names} for row in rows])


def compile_all(architectures: Iterable[int]) -> list[Code]:
    """The code of all kernels for GPUs that needn't be here; needs Triton. Raises ValueError where a kernel's loop
    isn't found, so that no time is left out unnoticed."""
    known = launches()
    chosen = [(kernel, chosen_launch(kernel, known)) for kernel in kernels()]
    return [row for kernel, launch in chosen for one in architectures for row in code_of(kernel, launch, one)]


def chosen_launch(kernel: Kernel, known: list[dict[str, Any]]) -> dict[str, Any]:
    """The recorded launch of a kernel with the constants that it is to have."""
    for launch in known:
        constants = dict(launch["constants"])
        same_op = launch["module"].split(".")[-2] == kernel.op and launch["function"] == kernel.name
        if same_op and kernel.constants.items() <= constants.items():
            return launch
    raise ValueError(f"{kernel.op}/{kernel.name}: no launch with {dict(kernel.constants)}")


def code_of(kernel: Kernel, launch: dict[str, Any], architecture: int) -> list[Code]:
    """The parts of one kernel's code for an architecture."""
    binary = binary_of(launch, architecture)
    row = compiled(launch, architecture, binary)
    return [
        Code(*kernel.code, architecture, row.warps, row.occupancy, loop, unrolled, sometimes, *pace.values())
        for loop, unrolled, sometimes, pace in told_apart(kernel, parts(listing(binary.asm["cubin"])))
    ]


def told_apart(kernel: Kernel, found: list[Part]) -> list[tuple[int, int, bool, Pace]]:
    """(loop, unrolled, sometimes, pace) of the parts that count. Loops that aren't among the kernel's are copies for
    cases that don't occur, such as blocks without any Gaussian. Copies of one loop for threads that have gone apart all
    count, as a warp goes through each of them. Raises ValueError where a loop is missing."""
    rows = _split(-1, 1, found[0], "memory", loop=False, apart=kernel.entered is not None)
    within = _around(found)
    for part, around in zip(found[1:], within[1:], strict=True):
        kinds = [one.kind for one in part.instructions]
        matching = (
            number
            for number, loop in enumerate(kernel.loops)
            if kinds.count(loop.kind) >= loop.each and loop.around in (None, around)
        )
        if (number := next(matching, None)) is None:
            continue
        loop = kernel.loops[number]
        unrolled = kinds.count(loop.kind) // loop.each if loop.each > 1 or loop.kind == "MUFU" else 1
        rows += _split(number, unrolled, part, kernel.loads, loop=True, apart=True)
    if missing := set(range(len(kernel.loops))) - {number for number, *_ in rows}:
        names = ", ".join(f"{kernel.loops[k].kind} x {kernel.loops[k].each}" for k in sorted(missing))
        # A loop whose number of passes is known may be unrolled altogether.
        if any(kernel.loops[k].kind != "BRA" for k in missing):
            raise ValueError(f"{kernel.op}/{kernel.name}: no loop with {names}")
    return rows


def _split(
    number: int, unrolled: int, part: Part, loads: str, *, loop: bool, apart: bool
) -> list[tuple[int, int, bool, Pace]]:
    """A part's row, or where branches may skip some of it, and `apart` that is told, two."""
    whole = pace_of(part.instructions, loop=loop, loads=loads)
    kept = [one for one, skipped in zip(part.instructions, part.sometimes, strict=True) if not (skipped and apart)]
    if len(kept) == len(part.instructions):
        return [(number, unrolled, False, whole)]
    always = pace_of(kept, loop=loop, loads=loads)
    return [(number, unrolled, False, always), (number, unrolled, True, whole.plus(always.times(-1)))]


def _around(found: list[Part]) -> list[int]:
    """For each part how many loops lie in it, one within the other."""
    levels = [0] * len(found)
    for number in range(len(found) - 1, 0, -1):
        parent = found[number].parent
        levels[parent] = max(levels[parent], levels[number] + 1)
    return levels


def passes(count: float, unrolled: int, largest: int, exact: bool) -> float:
    """Passes of a loop's code for `count` passes of the loop, where `largest` is the most unrolled copy of it: the
    whole passes of that copy, or what is left over for the copy that isn't unrolled. exact: whether count is the same
    in all programs; of a mean, (largest - 1) / 2 are left over on average."""
    left = count % largest if exact else min(count, (largest - 1) / 2)
    return (count - left) / largest if unrolled == largest else left


def listing(cubin: bytes) -> str:
    """The machine code as Triton's nvdisasm lists it."""
    import triton

    program = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "nvdisasm"
    with tempfile.NamedTemporaryFile(suffix=".cubin") as file:
        file.write(cubin)
        file.flush()
        return subprocess.run([program, "-c", file.name], capture_output=True, text=True, check=True).stdout
