"""How fast a multiprocessor runs a piece of machine code: which of its units each instruction takes, and how long one
warp alone takes for the piece, waiting for each operand.

Rates, in `gpu_peaks.py`, are in warp instructions a cycle of one multiprocessor.

Cycles until a result can be used: 4 for arithmetic (Jia et al., Dissecting the NVIDIA Volta GPU Architecture via
Microbenchmarking, 2018; Ampere and later are alike); shared memory 29, L1 38, L2 262 and memory 470 (Luo et al.,
Benchmarking and Dissecting the Nvidia Hopper GPU Architecture, 2024: A100, H100 and RTX 4090 differ by less than
15 %, so one number serves for all three). Special functions 20, shuffles 24, barriers 20 and float64 8 are assumed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from gpu_sass import Instruction

ARITHMETIC, SPECIAL, SHARED, SHUFFLE, BARRIER, DOUBLE = 4, 20, 29, 24, 20, 8
NEAR = {"l1": 38, "l2": 262, "memory": 470}
_FMA = ("FFMA", "FMUL", "FADD", "IMAD", "HFMA2", "FFMA32I", "FMUL32I", "FADD32I", "HADD2", "HMUL2")
_DOUBLE = ("DFMA", "DMUL", "DADD", "DSETP", "DMNMX")  # and conversions from and to float64
_SPECIAL = ("MUFU", "I2F", "F2I", "FRND", "F2F", "POPC", "FLO")
_MEMORY = ("LDG", "STG", "LDS", "STS", "LD", "ST", "LDL", "STL", "SHFL", "ATOMG", "ATOMS", "RED", "LDSM")
_STORES = ("STG", "STS", "ST", "STL", "RED", "BRA", "EXIT", "BAR", "BSYNC", "BSSY", "CALL", "NOP", "WARPSYNC", "DEPBAR")
_LOADS = ("LDG", "LD", "ATOMG")
_ADDRESSES = ("IMAD", "LEA", "IADD3", "SHF", "MOV", "VIADD")  # what makes addresses of numbers that were loaded
_LINE = 128  # bytes that one load brings to L1
_ADDRESS = re.compile(r"\[(R\d+)\.64(?:\+0x([0-9a-f]+))?\]")
_REGISTER = re.compile(r"\bU?[RP]\d+\b")
_WIDE = re.compile(r"\.(?:WIDE|64|HI\.X2)\b")


@dataclass(frozen=True)
class Pace:
    """What a piece of code takes of a multiprocessor.

    instructions: of a warp, in one pass. fma, double, alu, special, memory: those of them that take the units for
    products and sums of floats, for float64, for integers, comparisons and choices, for special functions and
    conversions, and for loads, stores and shuffles. alone: cycles of a pass of a warp that has the multiprocessor to
    itself.
    """

    instructions: float
    fma: float
    double: float
    alu: float
    special: float
    memory: float
    alone: float

    def times(self, passes: float) -> Pace:
        """All of it so many times."""
        return Pace(*(passes * value for value in self.values()))

    def plus(self, other: Pace) -> Pace:
        """Both, one after the other."""
        return Pace(*(a + b for a, b in zip(self.values(), other.values(), strict=True)))

    def values(self) -> tuple[float, ...]:
        """In the order of the fields."""
        return self.instructions, self.fma, self.double, self.alu, self.special, self.memory, self.alone


NOTHING = Pace(0, 0, 0, 0, 0, 0, 0)


def unit_of(one: Instruction) -> str:
    """The unit that an instruction takes: "fma", "double", "alu", "special", "memory", or "" for branches, barriers and
    what is the same for the whole warp, which take none of them."""
    if one.kind in _DOUBLE or (one.kind in _SPECIAL and ".F64" in one.name):
        return "double"
    if one.kind in _FMA:
        return "fma"
    if one.kind in _SPECIAL:
        return "special"
    if one.kind in _MEMORY:
        return "memory"
    if one.kind.startswith("U") or one.kind in _STORES or one.kind in ("LDC", "RET", "S2R", "CS2R", "S2UR"):
        return ""
    return "alu"


def pace_of(code: Sequence[Instruction], *, loop: bool, loads: str) -> Pace:
    """The pace of straight code. loop: whether it is passed through again and again, so that a pass ends where the next
    begins. loads: "l1", "l2" or "memory": where the loads of this code find what they read; one whose address was
    itself loaded finds it no nearer than in L2."""
    units = [unit_of(one) for one in code]
    once = _alone(code, loads)
    alone = _alone([*code, *code], loads) - once if loop else once
    return Pace(len(code), *(units.count(unit) for unit in ("fma", "double", "alu", "special", "memory")), alone)


def _alone(code: Sequence[Instruction], loads: str) -> float:
    """Cycles of one warp: instructions start in order, each when its operands are there."""
    ready: dict[str, float] = {}
    loaded: set[str] = set()
    lines: dict[tuple[str, int], float] = {}  # when the line of memory behind an address is there
    time = end = 0.0
    for one in code:
        names = _REGISTER.findall(one.operands)
        stores = one.kind in _STORES
        reads = {*names[0 if stores else 1 :], *_REGISTER.findall(one.predicate)}
        start = max([time, *(ready.get(name, 0.0) for name in reads)])
        follows = bool(reads & loaded)
        there = start + _delay(one, loads, follows)
        if one.kind in _LOADS and (address := _ADDRESS.search(one.operands)):
            line = address[1], int(address[2] or "0", 16) // _LINE
            there = max(start + NEAR["l1"], min(there, lines.setdefault(line, there)))
        time = start + (BARRIER if one.kind == "BAR" else 1)
        for name in [] if stores else _written(one, names):
            ready[name] = there
            loaded.discard(name)
            lines = {line: when for line, when in lines.items() if line[0] != name}
            if one.kind in _LOADS or (follows and one.kind in _ADDRESSES):
                loaded.add(name)
        end = max(end, time if stores else there)
    return max(time, end)


def _written(one: Instruction, names: list[str]) -> list[str]:
    if not names:
        return []
    first = names[0]
    written = [first]
    if "SETP" in one.kind and len(names) > 1 and "P" in names[1]:
        written.append(names[1])
    if "R" in first:
        many = 4 if ".128" in one.name else 2 if _WIDE.search(one.name) or one.kind == "CS2R" else 1
        number = int(re.sub(r"\D", "", first))
        written += [re.sub(r"\d+", str(number + k), first) for k in range(1, many)]
    return written


def _delay(one: Instruction, loads: str, follows: bool) -> float:
    if one.kind in _LOADS:
        return max(NEAR[loads], NEAR["l2"]) if follows else NEAR[loads]
    if one.kind in ("LDS", "LDSM"):
        return SHARED
    if one.kind == "SHFL":
        return SHUFFLE
    if unit_of(one) == "double":
        return DOUBLE
    return SPECIAL if one.kind in _SPECIAL else ARITHMETIC
