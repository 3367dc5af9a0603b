"""What says how much a GPU has to do in a call of an op: its Triton kernels, and what torch does beside them.

The ops themselves are in `gpu_work_rasterize.py` and the modules named alike. Bytes are those that have to come from
memory or go there once: what a kernel reads again is taken to be in a cache. What one kernel writes and the next reads
counts for both, though small pictures stay in L2. No kernel has atomics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gpu_peaks import Gpu

Number = Callable[[Any], float]  # of the sizes that the op has: Sizes, FieldSizes or StereoSizes


@dataclass(frozen=True)
class Loop:
    """A loop of a kernel. It is told in machine code by instructions of a kind, `each` of them in a pass; a loop with a
    multiple of them is unrolled.

    passes: in one program. taken: share of the passes that take the branch in it. exact: whether all programs have the
    same number of passes; otherwise it is a mean. around: how many loops lie in it, one within the other, where kinds
    don't tell the loops of a kernel apart; None where they do.
    """

    kind: str
    each: int
    passes: Number
    taken: Number = lambda sizes: 1.0
    exact: bool = False
    around: int | None = None


@dataclass(frozen=True)
class Kernel:
    """A Triton kernel in one configuration.

    op: the folder in kernels/ that it is in. variant: tells configurations of one kernel apart, "" if there is one.
    stage: of what it belongs to, as tables name it. backward: whether it belongs to the gradient. constants: its
    compile-time constants, as far as they tell configurations apart. programs: how many. moved: bytes. loads: where
    loads in loops find what they read if their address is known before. apart: cycles of L1 that a warp's loads
    and stores take beyond one each, since neighbouring threads' numbers lie apart (`loaded`, `stored`). longest:
    passes of the longest program over the mean. entered: share of the programs that find anything to do; of the others
    counts what no branch skips. None where all do, so that both sides of every branch outside of loops count. times:
    launches in a call of the op; 0 where its sizes have another configuration launched.
    """

    op: str
    name: str
    stage: str
    backward: bool
    programs: Number
    moved: Callable[[Any, Gpu], float]
    constants: Mapping[str, object] = field(default_factory=dict)
    loops: tuple[Loop, ...] = ()
    loads: str = "l1"
    apart: float = 0.0
    longest: Number = lambda sizes: 1.0
    entered: Number | None = None
    times: Number = lambda sizes: 1
    variant: str = ""

    @property
    def code(self) -> tuple[str, str, str]:
        """What names its machine code."""
        return self.op, self.name, self.variant


@dataclass(frozen=True)
class OtherWork:
    """What isn't looked at in machine code: operations of torch, and programs that end at once. All are taken to be
    bound by memory, or by their launches.

    name, stage, backward: as in `Kernel`. moved: bytes. launches: how many kernels. share: of the bandwidth that is
    reached. wait: seconds besides.
    """

    name: str
    stage: str
    backward: bool
    moved: Number
    launches: Number
    share: float = 1.0
    wait: float = 0.0


@dataclass(frozen=True)
class Op:
    """A call of an op: its kernels, and what happens beside them."""

    kernels: tuple[Kernel, ...] = ()
    others: tuple[OtherWork, ...] = ()


def blocks(size: Number, block: int) -> Number:
    """How many programs take `block` each."""
    return lambda s: math.ceil(size(s) / block)


def loaded(count: int, stride: int) -> int:
    """Cycles beyond one that L1 takes for each of `count` loads of numbers that lie `stride` bytes apart: it looks up
    four lines a cycle (NVIDIA, developer forum, "Pascal L1 cache", on Volta's)."""
    return count * (math.ceil(_lines(stride) / 4) - 1)


def stored(count: int, stride: int) -> int:
    """The same for stores, which all go on to L2: a line a cycle, an assumption."""
    return count * (_lines(stride) - 1)


def _lines(stride: int) -> int:
    """Lines of 128 bytes that 32 numbers touch, `stride` bytes apart."""
    return min(32, max(1, 32 * stride // 128))


def sorted_bytes(count: float, key: int) -> float:
    """Bytes that a radix sort moves for keys of `key` bytes with their places, 8 bytes each: a histogram of the keys,
    one pass for each byte that reads and writes both, and the places written before."""
    return count * (key + key * 2 * (key + 8) + 8)
