"""What the scatter does: its direct form and its linear one, of discs and of polygons.

Both forms share what comes before and behind them. A form is taken to have all tiles.
"""

from __future__ import annotations

import math
from dataclasses import replace

from gpu_scatter_windows import COARSE, FINE
from gpu_work import Kernel, Loop, Number, Op, OtherWork, blocks, loaded, stored

_DISC = {"SHAPED": False, "STOPPED": False}
_POLYGON = {"SHAPED": True, "STOPPED": False}
_PLACES = lambda s: s.offsets  # noqa: E731
_ROWS = lambda s: 2 * s.reach + 1  # noqa: E731
_TILES = lambda s: s.scatter_tiles  # noqa: E731
_TABLE = lambda s: 4 * (2 * s.reach + 1) ** 2  # noqa: E731  # bytes of a polygon's factors that a tile looks up
_CHUNKS, _SUMMED = 64, 512  # of a program that bounds, and places of one that adds

_BLOCKS = blocks(lambda s: s.pixels, 512)
_SUMMED_PASSES = lambda s: math.ceil(_BLOCKS(s) / 1024)  # noqa: E731  # over the blocks' sums

# What both forms have in common.
_PREPARED = (
    Kernel(
        "scatter", "pack_sources", "lens forward", False, _BLOCKS,
        lambda s, _: s.pixels * (16 + 20), {"AREA": True}, apart=loaded(12, 12),
    ),
    Kernel(
        "scatter", "sum_usual", "lens forward", False, _BLOCKS, lambda s, _: s.pixels * 12,
        loops=(Loop("LDG", 8, _SUMMED_PASSES),), apart=loaded(12, 12),
    ),
    Kernel(
        "scatter", "join_sums", "lens forward", False, lambda s: 1, lambda s, _: 20 * _BLOCKS(s),
        loops=(Loop("LDG", 8, _SUMMED_PASSES),), loads="memory",  # five times, each for a row of sums
    ),
    Kernel(
        "scatter", "tile_reach", "lens forward", False, _TILES, lambda s, _: 16 * s.pixels, apart=loaded(6, 12)
    ),
    Kernel(
        "scatter", "tile_window", "lens forward", False, _TILES, lambda s, _: 8 * s.scatter_tiles,
        loops=(Loop("LDG", 4, lambda s: math.ceil(s.scatter_tiles / 512)),),
    ),
)  # fmt: skip
_TARGETS = Kernel(
    "scatter", "pack_targets", "lens backward", True, blocks(lambda s: s.pixels, 512),
    lambda s, _: s.pixels * (28 + 16), apart=loaded(24, 12),
)  # fmt: skip

_GATHER = Kernel(
    "scatter", "gather", "lens forward", False, _TILES, lambda s, _: s.pixels * (20 + 16), _DISC,
    (Loop("LDG", 10, _PLACES), Loop("MUFU", 1, _ROWS)), apart=stored(6, 12),
)  # fmt: skip
_GATHER_GRADIENT = Kernel(
    "scatter", "gather_gradient", "lens backward", True, _TILES, lambda s, _: s.pixels * (32 + 16),
    {"AREA": True, **_DISC}, (Loop("LDG", 8, _PLACES), Loop("MUFU", 1, _ROWS)),
    apart=loaded(6, 12) + stored(6, 12),
)  # fmt: skip


def _windows(shape: str) -> tuple[Loop, ...]:
    """The loops of the linear form, one within the other: single offsets, fine windows, coarse ones, rows. shape:
    "disc" or "polygon". What a branch in a loop over windows holds counts where a source may reach the window, though
    a window's sum is added or the window is divided, never both."""
    return (
        Loop("MUFU", 5, lambda s: getattr(s, shape).taps, around=0),
        Loop("LDG", 8, lambda s: getattr(s, shape).fine, lambda s: getattr(s, shape).fine_met, around=1),
        Loop("LDG", 8, lambda s: getattr(s, shape).coarse, lambda s: getattr(s, shape).coarse_met, around=2),
        Loop("MUFU", 1, _ROWS, around=3),
    )


def _bound_columns(wide: int) -> Number:
    """How many windows of a row have bounds: they begin before the picture, where a tile's first windows lie."""
    return lambda s: math.ceil((s.width + 32 + COARSE) / COARSE) * (COARSE // wide)


def _region_bounds(variant: str, wide: int, chunks: int) -> Kernel:
    """A program for each row and 64 columns; each reads the chunks behind a window in the eight rows of a tile."""
    columns = _bound_columns(wide)
    return Kernel(
        "scatter", "region_bounds", "lens forward", False,
        lambda s: (s.height + 7) * math.ceil(columns(s) / _CHUNKS),
        lambda s, _: 4 * s.pixels + 16 * (s.height + 7) * columns(s),
        {"COUNT": chunks}, (Loop("LDG", 4 * chunks, lambda s: 8),), loads="l2", variant=variant,
    )  # fmt: skip


def _add_windows(variant: str, step: int, wide: int) -> Kernel:
    """Of four planes; the wide ones are added from the narrow."""
    return Kernel(
        "scatter", "add_windows", "lens forward", False,
        lambda s: 4 * s.height * math.ceil((s.width + wide - 1) / _SUMMED),
        lambda s, _: 16 * s.height * (2 * s.width + wide), {"STEP": step}, variant=variant,
    )  # fmt: skip


_SUMS = _add_windows("fine", 1, FINE), _add_windows("coarse", FINE, COARSE)
_SUMS_BACK = tuple(replace(one, stage="lens backward", backward=True) for one in _SUMS)
_BOUNDS = (
    # Chunks are as wide as a fine window, so that 256 neighbouring pixels belong to the 64 of a program.
    Kernel(
        "scatter", "chunk_bounds", "lens forward", False, lambda s: s.height * math.ceil(s.width / (FINE * _CHUNKS)),
        lambda s, _: s.pixels * (16 + 4), apart=loaded(6, 12),
    ),
    _region_bounds("fine", FINE, (32 + FINE) // FINE),
    _region_bounds("coarse", COARSE, (32 + COARSE) // FINE),
)  # fmt: skip
_GATHER_WINDOWS = Kernel(
    "scatter", "gather_windows", "lens forward", False, _TILES,
    lambda s, _: s.pixels * (20 + 32 + 16)
    + 16 * (s.height + 7) * sum(_bound_columns(wide)(s) for wide in (FINE, COARSE)),
    _DISC, _windows("disc"), apart=stored(6, 12),
)  # fmt: skip
_GRADIENT_WINDOWS = Kernel(
    "scatter", "gather_gradient_windows", "lens backward", True, _TILES, lambda s, _: s.pixels * (16 + 32 + 16 + 16),
    {"AREA": True, **_DISC}, _windows("disc"), apart=loaded(6, 12) + stored(6, 12),
)  # fmt: skip


def _shaped(kernel: Kernel, loops: tuple[Loop, ...]) -> Kernel:
    """The same kernel of polygons, which looks up a table of factors by direction as well."""
    return replace(
        kernel, constants={**kernel.constants, **_POLYGON}, loops=loops, variant="polygon",
        moved=lambda s, gpu: kernel.moved(s, gpu) + _TABLE(s),
    )  # fmt: skip


def _form(forward: tuple[Kernel, ...], backward: tuple[Kernel, ...]) -> Op:
    return Op((*_PREPARED, *forward, _TARGETS, *backward))


DIRECT = _form((_GATHER,), (_GATHER_GRADIENT,))
LINEAR = _form((*_BOUNDS, *_SUMS, _GATHER_WINDOWS), (*_SUMS_BACK, _GRADIENT_WINDOWS))
DIRECT_POLYGON = _form(
    (_shaped(_GATHER, (Loop("LDG", 11, _PLACES), Loop("MUFU", 1, _ROWS))),),
    (_shaped(_GATHER_GRADIENT, (Loop("LDG", 9, _PLACES), Loop("MUFU", 1, _ROWS))),),
)
LINEAR_POLYGON = _form(
    (*_BOUNDS, *_SUMS, _shaped(_GATHER_WINDOWS, _windows("polygon"))),
    (*_SUMS_BACK, _shaped(_GRADIENT_WINDOWS, _windows("polygon"))),
)
# As training calls it: both forms are launched, since the host doesn't know how wide circles are, and where none is
# wide the linear form's programs end at once.
BOTH = Op(
    DIRECT.kernels,
    (
        *DIRECT.others,
        OtherWork("the linear form ends at once", "lens forward", False, lambda s: 0, lambda s: 6),
        OtherWork("the linear form ends at once", "lens backward", True, lambda s: 0, lambda s: 3),
    ),
)
