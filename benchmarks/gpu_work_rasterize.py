"""What the rasteriser does: projection, tiles' lists, blending and its gradient, seen from the centre of the lens or
from points of it.

A Gaussian's record, read anew for each tile, is in L2 as long as all records fit there, and comes from memory
otherwise.
"""

from __future__ import annotations

from gpu_peaks import SORT_SHARE, WAIT, Gpu
from gpu_sizes import LENS_POINTS, TILE, Sizes
from gpu_work import Kernel, Loop, Op, OtherWork, blocks, loaded, sorted_bytes, stored

CHUNK = 64  # Gaussians of a list that one program of blending's gradient goes through
SLOT = 14  # numbers of an intersection's contribution to the gradient: three for depth or for points, two absolute

_CENTRE = {"FADES": True, "FILTERED": True, "BLURRED": False, "MOVED": False}
_POINTS = {**_CENTRE, "BLURRED": True, "MOVED": True}
_TILES = lambda s: s.tiles  # noqa: E731
_GAUSSIANS = blocks(lambda s: s.gaussians, 128)
_LIST = lambda s: s.followed / s.tiles  # noqa: E731
_LONGEST = lambda s: s.longest_list  # noqa: E731
_BLENDED = Loop("MUFU", 2, _LIST), Loop("SHFL", 10, lambda s: s.followed / s.tiles / 16)
_CHUNKS = lambda s: s.followed / CHUNK + s.tiles / 2  # noqa: E731  # that hold any: a list's last is half full
_ALL_CHUNKS = lambda s: s.pairs / CHUNK + s.tiles  # noqa: E731
_ENTERED = lambda s: _CHUNKS(s) / _ALL_CHUNKS(s)  # noqa: E731
_FULL = lambda s: CHUNK * _CHUNKS(s) / s.followed  # noqa: E731  # a full chunk's passes over the mean
_BLENDED_BACK = (
    Loop("MUFU", 16, lambda s: s.followed / _CHUNKS(s), lambda s: s.taken),
    Loop("LDG", 1, lambda s: int(s.points * s.tiles).bit_length(), exact=True),  # the bisection for a chunk's tile
)
# The bisection for an intersection's Gaussian, and the rows of tiles that it meets.
_FILLED = (
    Loop("LDG", 2, lambda s: int(s.points * s.gaussians).bit_length(), exact=True),
    Loop("MUFU", 8, lambda s: s.widest_rows),
)


def records(s: Sizes, gpu: Gpu) -> float:
    """Bytes of records that blending reads: each once, or for every entry of the lists."""
    return 64 * (s.seen if 64 * s.seen <= gpu.l2 else max(s.seen, s.followed))


def kept(s: Sizes, numbers: int) -> float:
    """Bytes of the sums of all pixels before each chunk."""
    return _CHUNKS(s) * TILE * TILE * 4 * numbers


def images(s: Sizes, channels: int) -> float:
    """Bytes of images that each chunk reads of its tile."""
    return _CHUNKS(s) * TILE * TILE * 4 * channels


def key(s: Sizes) -> int:
    """Bytes of a tile's number, gpu_lists.project_and_list."""
    return 2 if s.tiles < 2**15 else 4


# What is the same from the centre of the lens and from points of it.
_COLOR = Kernel(
    "rasterize", "color", "projection", False, _GAUSSIANS,
    lambda s, _: s.gaussians + s.seen * (12 + 12 + 12 * s.terms + 12),
    {"REST": 15, "TERMS": 15}, apart=loaded(6, 12) + loaded(45, 180) + stored(3, 64),
)  # fmt: skip
_SUM_SLOTS = Kernel(
    "rasterize", "sum_slots", "blend backward", True, blocks(lambda s: s.gaussians, 4),
    lambda s, _: 4 * SLOT * (s.pairs + s.gaussians) + 16 * s.gaussians,
    {"SLOT": SLOT}, (Loop("LDG", 4, lambda s: 1 + (s.points * s.most_intersections - 1) / 8),), loads="memory",
)  # fmt: skip
_COLOR_BACKWARD = Kernel(
    "rasterize", "color_backward", "projection backward", True, _GAUSSIANS,
    lambda s, _: s.gaussians * (1 + 12 + 12 * s.terms) + s.seen * (12 + 12 * s.terms + 12 + 12 + 24),
    {"SLOT": SLOT, "REST": 15, "TERMS": 15},
    apart=loaded(3, 64) + loaded(3, 4 * SLOT) + loaded(6, 12) + loaded(45, 180) + stored(45, 180) + stored(6, 12),
)  # fmt: skip
_OTHERS = (
    OtherWork("sort by depth", "sort", False, lambda s: sorted_bytes(s.gaussians, 4), lambda s: 4 + 3, SORT_SHARE),
    OtherWork("sort by tile", "sort", False, lambda s: sorted_bytes(s.pairs, key(s)), lambda s: key(s) + 3, SORT_SHARE),
    # Counts in order of depth, their running sum, and its last number, for which the host waits.
    OtherWork("ends", "lists", False, lambda s: (8 + 20 * s.points) * s.gaussians, lambda s: 4, wait=WAIT),
    OtherWork("starts and ids", "lists", False, lambda s: 16 * s.pairs, lambda s: 3),
    OtherWork("zeros", "blend backward", True, lambda s: 4 * SLOT * s.pairs, lambda s: 1),
)

FROM_CENTRE = Op(
    (
        Kernel(
            "rasterize", "project", "projection", False, _GAUSSIANS,
            lambda s, _: s.gaussians * (48 + 8) + 64 * s.seen,
            {"GEOMETRY": 1, **_CENTRE}, apart=loaded(6, 12) + loaded(4, 16) + stored(10, 64),
        ),
        Kernel(
            "rasterize", "count", "projection", False, _GAUSSIANS,
            lambda s, _: s.gaussians * (4 + 9) + 32 * s.seen,
            {"MOVED": False}, (Loop("MUFU", 4, lambda s: s.widest_rows),), apart=loaded(7, 64),
        ),
        _COLOR,
        # A Gaussian meets about two tiles, so the 32 neighbouring intersections of a warp touch some 16 records.
        Kernel(
            "rasterize", "fill", "lists", False, blocks(lambda s: s.pairs, 256),
            lambda s, _: s.pairs * (2 + 4) + s.seen * (64 + 8 + 8),
            {"MOVED": False}, _FILLED, loads="l2", apart=loaded(2 * 7, 64),
        ),
        Kernel(
            "rasterize", "blend", "blend forward", False, _TILES,
            lambda s, gpu: records(s, gpu) + 4 * s.followed + s.pixels * (12 + 4 + 4) + kept(s, 6),
            {"GEOMETRY": 1, "MOVED": False}, _BLENDED, longest=_LONGEST,
        ),
        Kernel(
            "rasterize", "blend_backward", "blend backward", True, _ALL_CHUNKS,
            lambda s, gpu: records(s, gpu) + s.followed * (12 + 4 * SLOT * s.taken) + kept(s, 6) + images(s, 2 * 5),
            {"LEVEL": 1, "MOVED": False, "ABSOLUTE": True}, _BLENDED_BACK, longest=_FULL, entered=_ENTERED,
        ),
        _SUM_SLOTS,
        Kernel(
            "rasterize", "project_backward", "projection backward", True, _GAUSSIANS,
            lambda s, _: s.gaussians * (1 + 44 + 8) + s.seen * (48 + 4 * SLOT),
            {"LEVEL": 1, **_CENTRE, "STATISTICS": True, "SLOT": SLOT},
            apart=loaded(9, 4 * SLOT) + loaded(6, 12) + loaded(4, 16) + stored(6, 12) + stored(4, 16) + stored(2, 8),
        ),
        _COLOR_BACKWARD,
    ),
    _OTHERS,
)  # fmt: skip

# Colour alone, without depth; each Gaussian has a radius, by which it is moved, and a blur of its own.
FROM_POINTS = Op(
    (
        Kernel(
            "rasterize", "project", "projection", False, _GAUSSIANS,
            lambda s, _: s.gaussians * (48 + 8 + 8) + 64 * s.seen,
            {"GEOMETRY": 0, **_POINTS}, apart=loaded(6, 12) + loaded(4, 16) + stored(7, 64), variant="points",
        ),
        Kernel(
            "rasterize", "count", "projection", False, _GAUSSIANS,
            lambda s, _: s.gaussians * (4 + 5 + 4 * s.points) + (32 + 4) * s.seen,
            {"MOVED": True}, (Loop("MUFU", 4, lambda s: s.points * s.widest_rows), Loop("BAR", 2, lambda s: s.points)),
            apart=loaded(7, 64) + stored(LENS_POINTS, 4 * LENS_POINTS), variant="points",
        ),
        _COLOR,
        Kernel(
            "rasterize", "fill", "lists", False, blocks(lambda s: s.pairs, 256),
            lambda s, _: s.pairs * (key(s) + 4) + s.seen * (64 + 4 + 8 + 8 * s.points),
            {"MOVED": True}, _FILLED, loads="l2", apart=loaded(2 * 7, 64), variant="points",
        ),
        Kernel(
            "rasterize", "blend", "blend forward", False, _TILES,
            lambda s, gpu: records(s, gpu) + 4 * s.seen + 4 * s.followed + s.points * s.pixels * (12 + 4) + kept(s, 4),
            {"GEOMETRY": 0, "MOVED": True}, _BLENDED, longest=_LONGEST, variant="points",
        ),
        Kernel(
            "rasterize", "blend_backward", "blend backward", True, _ALL_CHUNKS,
            lambda s, gpu: records(s, gpu) + 4 * s.seen + s.followed * (12 + 4 * SLOT * s.taken) + kept(s, 4)
            + images(s, 3 + 3 + 1),
            {"LEVEL": 0, "MOVED": True, "ABSOLUTE": True}, _BLENDED_BACK, longest=_FULL, entered=_ENTERED,
            variant="points",
        ),
        _SUM_SLOTS,
        Kernel(
            "rasterize", "project_backward", "projection backward", True, _GAUSSIANS,
            lambda s, _: s.gaussians * (1 + 44 + 8 + 8) + s.seen * (48 + 4 + 4 * SLOT),
            {"LEVEL": 0, **_POINTS, "STATISTICS": True, "SLOT": SLOT},
            apart=loaded(9, 4 * SLOT) + loaded(6, 12) + loaded(4, 16) + stored(6, 12) + stored(4, 16) + stored(2, 8),
            variant="points",
        ),
        _COLOR_BACKWARD,
    ),
    _OTHERS,
)  # fmt: skip
