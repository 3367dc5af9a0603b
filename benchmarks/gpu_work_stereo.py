"""What plane-sweep stereo does for one view: the sweep, the mixture with a coarser level, paths through the scores, and
the check against other views. It has no gradient.

A launch of the sweep's kernels has `together` planes. A path's 128 planes are one warp's.
"""

from __future__ import annotations

import math

from gpu_sizes_stereo import RADIUS
from gpu_work import Kernel, Loop, Op, OtherWork, stored

_ROWS, _BLOCK, _COSTS = 32, 128, 512  # of a strip; columns or pixels of a program; scores of one that chooses
_PATH_PLANES = 128
_SWEEPS = lambda s: s.sweeps  # noqa: E731

SWEEP = Op(
    (
        # Sources and reference once, and three sums for each plane, source and place.
        Kernel(
            "stereo", "sum_down", "sweep", False,
            lambda s: math.ceil(s.wide / _BLOCK) * math.ceil(s.height / _ROWS) * s.together * s.sources,
            lambda s, _: 4 * s.pixels * (s.sources + 1) + 12 * s.sources * s.together * s.height * s.wide,
            loops=(Loop("STG", 3, lambda s: _ROWS + 2 * RADIUS, exact=True),), times=_SWEEPS,
        ),
        # A pixel's scores for neighbouring planes lie beside each other, but the planes are different programs': each
        # store of a warp touches 32 lines, and what a launch writes of a pixel counts with the sectors of 32 bytes that
        # it lies across.
        Kernel(
            "stereo", "correlate", "sweep", False, lambda s: math.ceil(s.pixels / _BLOCK) * s.together,
            lambda s, _: 12 * s.sources * s.together * s.height * s.wide + s.pixels * (8 + 28 + 4 * s.together),
            {"BEST": 2}, (Loop("LDG", 30, lambda s: s.sources, exact=True),), apart=stored(1, 4 * 128), times=_SWEEPS,
        ),
    ),
    # Mean and deviation under the window in float64: padded, averaged, and the rest of it; and matrices.
    (OtherWork("means under windows", "sweep", False, lambda s: 8 * 20 * s.pixels, lambda s: 20),),
)  # fmt: skip

UPSAMPLE = Op(
    (
        Kernel(
            "stereo", "add_coarse", "coarser level", False,
            lambda s: math.ceil(s.width * s.planes / _BLOCK) * s.height,
            lambda s, _: 8 * s.scores + 4 * s.coarse_width * s.coarse_height * s.coarse_planes,
        ),
    )
)  # fmt: skip


def _add_path(first: bool, across: bool) -> Kernel:
    """One of the four directions. across: along rows; down columns otherwise. Each pixel waits for the one before."""
    return Kernel(
        "stereo", "add_path", "paths", False, (lambda s: s.height) if across else (lambda s: s.width),
        lambda s, _: (8 if first else 12) * s.scores + 4 * s.pixels,
        {"FIRST": first, "PLANES": _PATH_PLANES},
        (Loop("SHFL", 19, (lambda s: s.width) if across else (lambda s: s.height), exact=True),), loads="memory",
        variant="first" if first else "",
    )  # fmt: skip


SEMIGLOBAL = Op(
    (
        _add_path(first=True, across=True),
        _add_path(first=False, across=True),
        *[_add_path(first=False, across=False)] * 2,
        # The score of the chosen plane is a sector of 32 bytes for each pixel.
        Kernel(
            "stereo", "choose", "choice", False, lambda s: math.ceil(s.pixels * _PATH_PLANES / _COSTS),
            lambda s, _: 4 * s.scores + s.pixels * (12 + 32), {"PLANES": _PATH_PLANES},
        ),
    )
)  # fmt: skip

RETURNS = Op(
    (
        Kernel(
            "stereo", "find_returns", "check", False, lambda s: math.ceil(s.pixels / _BLOCK),
            lambda s, _: 9 * s.pixels, loads="memory",
        ),
    )
)  # fmt: skip
