"""Registers, spills and occupancy of every GPU kernel, compiled ahead of time without a GPU: kernels.csv.

    python -m benchmarks.gpu.kernels --out reports/gpu

Every launch of a Triton kernel that training makes (`launches.py`) is compiled for each architecture. From the
machine code come the registers of a thread, spilled bytes and the shared memory of a program, and from these the
occupancy: the share of a multiprocessor's threads that the kernel can fill. A kernel that
spills, or has less than half occupancy, needs a reason in reasons.csv next to this file; without one the command ends
with status 1. No GPU and no driver are needed: Triton brings the assembler.
"""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import tyro

from dofbench.core.files import write_csv

HERE = Path(__file__).resolve().parent
LOW = 0.5  # occupancy


@dataclass(frozen=True)
class Settings:
    """Where the table goes, and for which architectures."""

    out: Path
    """Folder for kernels.csv."""
    architectures: tuple[int, ...] = (80, 90, 100)
    """Compute capabilities times ten: 80 is an A100, 89 an RTX 4090, 90 an H100, 100 a B200."""


@dataclass(frozen=True)
class Multiprocessor:
    """Limits of one multiprocessor (NVIDIA, CUDA C++ Programming Guide, table of compute capabilities)."""

    warps: int
    programs: int
    shared: int  # bytes
    registers: int = 65536

    def occupancy(self, registers: int, shared: int, warps: int) -> float:
        """Share of the warps that it holds at once. registers: of a thread. shared: bytes of a program. warps: of a
        program. Registers are given out to whole warps, 256 at a time, on each of four parts; each program takes 1 KiB
        of shared memory besides."""
        of_warp = -(-registers * 32 // 256) * 256
        by_registers = 4 * (self.registers // 4 // of_warp) // warps if of_warp else self.programs
        by_shared = self.shared // (shared + 1024)
        return min(self.programs, by_registers, by_shared, self.warps // warps) * warps / self.warps


MULTIPROCESSORS = {
    80: Multiprocessor(64, 32, 164 * 1024),
    89: Multiprocessor(48, 24, 100 * 1024),
    90: Multiprocessor(64, 32, 228 * 1024),
    100: Multiprocessor(64, 32, 228 * 1024),
}


@dataclass(frozen=True)
class Row:
    """A kernel in one configuration on one architecture. constants: those that it was compiled with. spilled: bytes of
    a thread. shared: bytes of a program. occupancy: 0 to 1."""

    op: str
    kernel: str
    constants: str
    architecture: int
    warps: int
    registers: int
    spilled: int
    shared: int
    occupancy: float


def main(settings: Settings) -> None:
    """Compile, write the table, and end with status 1 where a kernel has no reason for what it needs."""
    rows = [compiled(launch, one) for launch in launches() for one in settings.architectures]
    rows.sort(key=lambda row: (row.op, row.kernel, row.constants, row.architecture))
    settings.out.mkdir(parents=True, exist_ok=True)
    names = tuple(field.name for field in fields(Row))
    write_csv(settings.out / "kernels.csv", names, [{name: getattr(row, name) for name in names} for row in rows])
    with (HERE / "reasons.csv").open(encoding="utf-8", newline="") as stream:
        reasons = {row["kernel"] for row in csv.DictReader(stream)}
    if lacking := unexplained(rows, reasons):
        raise SystemExit("without a reason in reasons.csv: " + ", ".join(lacking))


def launches() -> list[dict[str, Any]]:
    """The launches of training, from a process in which kernels are interpreted."""
    environment = os.environ | {"TRITON_INTERPRET": "1"}
    command = [sys.executable, "-m", "benchmarks.gpu.launches"]
    done = subprocess.run(command, cwd=HERE.parents[1], env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def binary_of(launch: dict[str, Any], architecture: int) -> Any:
    """What Triton makes of a launch's kernel for an architecture. Tensors begin at multiples of 16 bytes, as torch's
    allocator has them: Triton looks at that when a kernel is launched, and then loads up to four numbers at once."""
    import triton
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    kernel = getattr(import_module(launch["module"]), launch["function"])
    signature, constants = dict(launch["signature"]), dict(launch["constants"])
    pointers = [place for place, kind in enumerate(signature.values()) if kind.startswith("*")]
    aligned = {(place,): [["tt.divisibility", 16]] for place in pointers}
    source = ASTSource(fn=kernel, signature=signature, constexprs=constants, attrs=aligned)
    target = GPUTarget("cuda", architecture, 32)
    return triton.compile(source, target=target, options={"num_warps": launch["warps"]})


def compiled(launch: dict[str, Any], architecture: int, binary: Any = None) -> Row:
    """A launch's kernel as the assembler made it for an architecture. binary: of `binary_of`, if it is there."""
    binary = binary_of(launch, architecture) if binary is None else binary
    registers, stack, shared = usage(binary.asm["cubin"])
    shared = max(shared, binary.metadata.shared)
    return Row(
        op=launch["module"].split(".")[-2],
        kernel=launch["function"],
        constants=" ".join(f"{name}={value}" for name, value in dict(launch["constants"]).items()),
        architecture=architecture,
        warps=launch["warps"],
        registers=registers,
        spilled=stack,
        shared=shared,
        occupancy=MULTIPROCESSORS[architecture].occupancy(registers, shared, launch["warps"]),
    )


def usage(cubin: bytes) -> tuple[int, int, int]:
    """(registers of a thread, bytes of its stack, bytes of a program's shared memory), as Triton's cuobjdump says."""
    import triton

    program = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
    with tempfile.NamedTemporaryFile(suffix=".cubin") as file:
        file.write(cubin)
        file.flush()
        told = subprocess.run([program, "-res-usage", file.name], capture_output=True, text=True, check=True).stdout
    registers, stack, shared = (int(re.search(rf"{word}:(\d+)", told)[1]) for word in ("REG", "STACK", "SHARED"))
    return registers, stack, shared


def unexplained(rows: list[Row], reasons: set[str]) -> list[str]:
    """Kernels that spill or fill less than half a multiprocessor, and have no reason listed."""
    needy = {f"{row.op}/{row.kernel}" for row in rows if row.spilled or row.occupancy < LOW}
    return sorted(needy - reasons)


if __name__ == "__main__":
    main(tyro.cli(Settings))
