"""What each kernel of a training step does: programs, bytes and passes of its loops, by the sizes of the workload.

Bytes are those that have to come from memory or go there once: what a kernel reads again is taken to be in a cache. A
Gaussian's record, read anew for each tile, is in L2 as long as all records fit there, and comes from memory otherwise.
What one kernel writes and the next reads counts for both, though small pictures stay in L2. No kernel has atomics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gpu_peaks import Gpu
from gpu_sizes import Sizes

SLOT = 14  # numbers of an intersection's contribution to the gradient: with depth and sums of absolute values
PARAMETERS = 59  # numbers of a Gaussian: mean, scales, quaternion, opacity and 16 coefficients of three colours
MIX = 9  # width of the mixed neighbourhood, BAGS' middle scale

Number = Callable[[Sizes], float]


@dataclass(frozen=True)
class Loop:
    """A loop of a kernel. It is told in machine code by instructions of a kind, `each` of them in a pass; a loop with a
    multiple of them is unrolled.

    passes: in one program. taken: share of the passes that take the branch in it. exact: whether all programs have the
    same number of passes; otherwise it is a mean.
    """

    kind: str
    each: int
    passes: Number
    taken: Number = lambda sizes: 1.0
    exact: bool = False


@dataclass(frozen=True)
class Kernel:
    """A Triton kernel in the configuration of the preset `gpu`.

    op: that it belongs to. stage: of a training step. backward: whether it belongs to the gradient. constants: its
    compile-time constants, as far as they tell configurations apart. programs: how many. moved: bytes. loads: where
    loads in loops find what they read if their address is known before. apart: cycles of L1 that a warp's loads
    and stores take beyond one each, since neighbouring threads' numbers lie apart (`_loaded`, `_stored`). calls: in a
    training step. longest: passes of the longest program over the mean.
    """

    op: str
    name: str
    stage: str
    backward: bool
    programs: Number
    moved: Callable[[Sizes, Gpu], float]
    constants: Mapping[str, object] = field(default_factory=dict)
    loops: tuple[Loop, ...] = ()
    loads: str = "l1"
    apart: float = 0.0
    calls: int = 1
    longest: Number = lambda sizes: 1.0


def _blocks(size: Number, block: int) -> Number:
    return lambda s: math.ceil(size(s) / block)


def _records(s: Sizes, gpu: Gpu) -> float:
    """Bytes of records that blending reads: each once, or for every entry of the lists."""
    return 64 * (s.seen if 64 * s.seen <= gpu.l2 else max(s.seen, s.followed))


def _lines(stride: int) -> int:
    """Lines of 128 bytes that 32 numbers touch, `stride` bytes apart."""
    return min(32, max(1, 32 * stride // 128))


def _loaded(count: int, stride: int) -> int:
    """Cycles beyond one that L1 takes for each of `count` loads: it looks up four lines a cycle (NVIDIA, developer
    forum, "Pascal L1 cache", on Volta's)."""
    return count * (math.ceil(_lines(stride) / 4) - 1)


def _stored(count: int, stride: int) -> int:
    """The same for stores, which all go on to L2: a line a cycle, an assumption."""
    return count * (_lines(stride) - 1)


def _image_kernel(name: str, backward: bool, planes: int, loads: int, **constants: object) -> Kernel:
    """A kernel of SSIM, for 256 numbers of a row; planes: of three colours that it reads or writes."""
    return Kernel(
        "ssim",
        name,
        "loss",
        backward,
        lambda s: math.ceil(3 * s.width / 256) * s.height,
        lambda s, _: 4 * planes * s.numbers,
        constants,
        (Loop("LDG", loads, lambda s: 11, exact=True),),
    )


_LOSS = {"WEIGHTED": False, "WEIGH_ALL": False, "L1": True, "EDGES": True}
_DISC = {"SHAPED": False, "STOPPED": False}
_SEEN = {"FADES": True, "FILTERED": True, "BLURRED": False, "MOVED": False}
_PLACES = lambda s: s.offsets  # noqa: E731
_ROWS = lambda s: 2 * s.reach + 1  # noqa: E731
_TILES = lambda s: s.tiles  # noqa: E731
_SCATTER_TILES = lambda s: s.scatter_tiles  # noqa: E731
_GAUSSIANS = _blocks(lambda s: s.gaussians, 128)
_LIST = lambda s: s.followed / s.tiles  # noqa: E731
_LONGEST = lambda s: s.longest_list  # noqa: E731
_MIXED = _blocks(lambda s: s.pixels, 128)
_AROUND = lambda s: MIX * MIX  # noqa: E731

KERNELS = (
    Kernel(
        "rasterize", "project", "projection", False, _GAUSSIANS,
        lambda s, _: s.gaussians * (48 + 8) + 64 * s.seen,
        {"GEOMETRY": 1, **_SEEN}, apart=_loaded(6, 12) + _loaded(4, 16) + _stored(10, 64),
    ),
    Kernel(
        "rasterize", "count", "projection", False, _GAUSSIANS,
        lambda s, _: s.gaussians * (4 + 9) + 32 * s.seen,
        {"MOVED": False}, (Loop("MUFU", 4, lambda s: s.widest_rows),), apart=_loaded(7, 64),
    ),
    Kernel(
        "rasterize", "color", "projection", False, _GAUSSIANS,
        lambda s, _: s.gaussians + s.seen * (12 + 12 + 12 * s.terms + 12),
        {"REST": 15, "TERMS": 15}, apart=_loaded(6, 12) + _loaded(45, 180) + _stored(3, 64),
    ),
    # A Gaussian meets about two tiles, so the 32 neighbouring intersections of a warp touch some 16 records.
    Kernel(
        "rasterize", "fill", "lists", False, _blocks(lambda s: s.pairs, 256),
        lambda s, _: s.pairs * (2 + 4) + s.seen * (64 + 8 + 8),
        {"MOVED": False},
        (Loop("LDG", 2, lambda s: int(s.gaussians).bit_length(), exact=True), Loop("MUFU", 8, lambda s: s.widest_rows)),
        loads="l2", apart=_loaded(2 * 7, 64),
    ),
    Kernel(
        "rasterize", "blend", "blend forward", False, _TILES,
        lambda s, gpu: _records(s, gpu) + 4 * s.followed + s.pixels * (12 + 4 + 4),
        {"GEOMETRY": 1, "MOVED": False},
        (Loop("MUFU", 2, _LIST), Loop("SHFL", 10, lambda s: s.followed / s.tiles / 16)), longest=_LONGEST,
    ),
    Kernel(
        "rasterize", "blend_backward", "blend backward", True, _TILES,
        lambda s, gpu: _records(s, gpu) + s.followed * (12 + 4 * SLOT * s.taken) + s.pixels * 2 * (12 + 4 + 4),
        {"LEVEL": 1, "MOVED": False, "ABSOLUTE": True},
        (Loop("MUFU", 16, _LIST, lambda s: s.taken),), longest=_LONGEST,
    ),
    Kernel(
        "rasterize", "sum_slots", "blend backward", True, _blocks(lambda s: s.gaussians, 4),
        lambda s, _: 4 * SLOT * (s.pairs + s.gaussians) + 16 * s.gaussians,
        {"SLOT": SLOT}, (Loop("LDG", 4, lambda s: 1 + (s.most_intersections - 1) / 8),), loads="memory",
    ),
    Kernel(
        "rasterize", "project_backward", "projection backward", True, _GAUSSIANS,
        lambda s, _: s.gaussians * (1 + 44 + 8) + s.seen * (48 + 4 * SLOT),
        {"LEVEL": 1, **_SEEN, "STATISTICS": True, "SLOT": SLOT},
        apart=_loaded(9, 4 * SLOT) + _loaded(6, 12) + _loaded(4, 16) + _stored(6, 12) + _stored(4, 16)
        + _stored(2, 8),
    ),
    Kernel(
        "rasterize", "color_backward", "projection backward", True, _GAUSSIANS,
        lambda s, _: s.gaussians * (1 + 12 + 12 * s.terms) + s.seen * (12 + 12 * s.terms + 12 + 12 + 24),
        {"SLOT": SLOT, "REST": 15, "TERMS": 15},
        apart=_loaded(3, 64) + _loaded(3, 4 * SLOT) + _loaded(6, 12) + _loaded(45, 180) + _stored(45, 180)
        + _stored(6, 12),
    ),
    Kernel(
        "tone", "power", "lens forward", False, _blocks(lambda s: s.numbers, 1024), lambda s, _: 8 * s.numbers, calls=2,
    ),
    Kernel(
        "tone", "power_gradient", "lens backward", True, _blocks(lambda s: s.numbers, 1024),
        lambda s, _: 16 * s.numbers, calls=2,
    ),
    Kernel(
        "scatter", "pack_sources", "lens forward", False, _blocks(lambda s: s.pixels, 512),
        lambda s, _: s.pixels * (16 + 20), {"AREA": True}, apart=_loaded(12, 12),
    ),
    Kernel(
        "scatter", "tile_reach", "lens forward", False, _SCATTER_TILES, lambda s, _: 16 * s.pixels, apart=_loaded(6, 12)
    ),
    Kernel(
        "scatter", "tile_window", "lens forward", False, _SCATTER_TILES, lambda s, _: 8 * s.scatter_tiles,
        loops=(Loop("LDG", 4, lambda s: math.ceil(s.scatter_tiles / 512)),),
    ),
    Kernel(
        "scatter", "gather", "lens forward", False, _SCATTER_TILES, lambda s, _: s.pixels * (20 + 16), _DISC,
        (Loop("LDG", 10, _PLACES), Loop("MUFU", 1, _ROWS)), apart=_stored(6, 12),
    ),
    Kernel(
        "scatter", "pack_targets", "lens backward", True, _blocks(lambda s: s.pixels, 512),
        lambda s, _: s.pixels * (28 + 16), apart=_loaded(24, 12),
    ),
    Kernel(
        "scatter", "gather_gradient", "lens backward", True, _SCATTER_TILES, lambda s, _: s.pixels * (32 + 16),
        {"AREA": True, **_DISC}, (Loop("LDG", 8, _PLACES), Loop("MUFU", 1, _ROWS)),
        apart=_loaded(6, 12) + _stored(6, 12),
    ),
    _image_kernel("filter_images_along_rows", False, 2 + 4, 5),
    _image_kernel("compare", False, 4 + 2 + 3, 9, **_LOSS),
    _image_kernel("filter_slopes_along_rows", True, 3 + 3, 7),
    _image_kernel("gradient", True, 3 + 2 + 1, 7, **_LOSS),
    # Logits of neighbouring pixels lie 4 * 81 bytes apart, so that every load of a warp touches 32 lines.
    Kernel(
        "mix", "mixed", "mix", False, _MIXED, lambda s, _: s.pixels * (12 + 4 * MIX * MIX + 12 + 8),
        {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 1, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
        apart=_loaded(2 * MIX * MIX, 4 * MIX * MIX), calls=0,
    ),
    Kernel(
        "mix", "by_logits", "mix", True, _MIXED, lambda s, _: s.pixels * (8 * MIX * MIX + 12 + 12 + 8 + 12),
        {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 2, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
        apart=_loaded(MIX * MIX, 4 * MIX * MIX) + _stored(MIX * MIX, 4 * MIX * MIX), calls=0,
    ),
    Kernel(
        "mix", "by_image", "mix", True, _MIXED, lambda s, _: s.pixels * (4 * MIX * MIX + 8 + 12 + 12),
        {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 2, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
        apart=_loaded(MIX * MIX, 4 * MIX * MIX), calls=0,
    ),
)  # fmt: skip
