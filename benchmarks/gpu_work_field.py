"""What a radiance field does in a training step: its samples, what rays see, the gradients, and torch's part; besides,
densities at points and what the grid stores at points.

Ranks are the presets', 8 for the density and 16 for the colour. Rays learn too, as a lens makes them. A program sums at
four nodes of a plane, or at one where cells are crowded. A grid is taken to lie in L2. The kernels read all channels of
a node together, and 8 or 16 of them are 32 or 64 bytes beside each other, so that loads of a warp touch few lines.
"""

from __future__ import annotations

import math
from dataclasses import replace

from gpu_peaks import SORT_SHARE, WAIT
from gpu_sizes_field import CELLS, COLOUR, DENSITY, TERMS
from gpu_work import Kernel, Loop, Number, Op, OtherWork, blocks, loaded, sorted_bytes, stored

_RAYS = lambda s: s.rays  # noqa: E731
_PARTS = 3  # groups of channels of three modes: of either rank one a mode
_LIGHTS = 3 * 3 * COLOUR  # numbers that a ray's direction of view multiplies its samples' channels by
_OF_RAY, _SHADED, _SPREAD_DENSITY, _SPREAD_COLOUR = 32, 16, 32, 8  # samples of a ray that are read together


def _per_ray(count: str, block: int) -> tuple[Loop, ...]:
    """The loop over a ray's samples. count: which of them."""
    return (Loop("LDG", 1, lambda s: s.along(getattr(s, count), block)),)


def _longest(count: str, block: int) -> Number:
    """The longest loop over a ray's samples, over the mean."""
    return lambda s: s.all_along(block) / s.along(getattr(s, count), block)


# ---- samples ----

SAMPLES = Op(
    (
        # The marks of 64 steps, a byte each, and which cells are occupied.
        Kernel(
            "field", "mark", "samples", False, _RAYS, lambda s, _: s.rays * (44 + s.steps) + CELLS**3,
            loops=(Loop("LDG", 4, lambda s: math.ceil(s.steps / 128), exact=True),), loads="l2",
        ),
        Kernel(
            "field", "fill", "samples", False, _RAYS,
            lambda s, _: s.rays * (20 + s.steps) + 8 * s.all_samples,
            loops=(Loop("LDG", 4, lambda s: math.ceil(s.steps / 128), exact=True),), loads="l2",
        ),
    ),
    # The running sum of the counts and its padding, and its last number, for which the host waits.
    (OtherWork("starts", "samples", False, lambda s: 40 * s.rays, lambda s: 3, wait=WAIT),),
)  # fmt: skip

# ---- what rays see, and its gradient ----

_FIND_CELLS = Kernel(
    "field", "find_cells", "cells", True, blocks(lambda s: s.all_samples, 256),
    lambda s, _: s.all_samples * (4 + 4 + 4 + 12 + 24) + 24 * s.rays, apart=stored(6, 12),
)  # fmt: skip
# A histogram and four passes over the keys of 32 bits, each sample having six; then where each number of a cell begins.
_SORTED = (
    OtherWork("sort by cell", "cells", True, lambda s: sorted_bytes(6 * s.all_samples, 4), lambda s: 4 + 3, SORT_SHARE),
    OtherWork("where cells begin", "cells", True, lambda s: 24 * s.all_samples + 12 * s.numbers_of_cells, lambda s: 2),
)


def _at_nodes(name: str, rank: int, numbers: int, count: str) -> tuple[Kernel, ...]:
    """The kernels that sum what samples add to nodes, of the density or of the colour. count: whose samples."""
    samples = lambda s: s.rays * getattr(s, count)  # noqa: E731
    planes, lines = f"planes_{name}", f"lines_{name}"
    # Of each sample its row of channels, its place in the list and its two shares, for three planes; where the cells
    # begin; and all nodes.
    few = Kernel(
        "field", "add_to_planes", "sums at nodes", True, blocks(lambda s: s.plane_nodes, 4),
        lambda s, _: 3 * samples(s) * (4 * rank + 8 + 8) + 8 * s.plane_cells + 4 * rank * s.plane_nodes,
        {"NUMBERS": numbers, "RANK": rank, "NODES": 4}, (Loop("LDG", 4, lambda s: getattr(s, planes)),),
        loads="memory", longest=lambda s: getattr(s, f"{planes}_longest") / getattr(s, planes),
        entered=lambda s: getattr(s, f"{planes}_some"), times=lambda s: int(not s.crowded), variant=name,
    )  # fmt: skip
    many = replace(
        few, programs=lambda s: s.plane_nodes, constants={**few.constants, "NODES": 1},
        times=lambda s: int(s.crowded), variant=f"{name}, crowded",
    )  # fmt: skip
    return (
        few,
        many,
        Kernel(
            "field", "add_in_line_cells", "sums at nodes", True, lambda s: 4 * s.line_cells,
            lambda s, _: 3 * samples(s) * (4 * rank + 8 + 4) + 8 * s.line_cells + 4 * 4 * 2 * rank * s.line_cells,
            {"NUMBERS": numbers, "RANK": rank}, (Loop("LDG", 1, lambda s: getattr(s, lines)),),
            loads="memory", longest=lambda s: getattr(s, f"{lines}_longest") / getattr(s, lines), variant=name,
        ),
        Kernel(
            "field", "add_to_lines", "sums at nodes", True, blocks(lambda s: 3 * s.nodes, 4),
            lambda s, _: 4 * 4 * 2 * rank * s.line_cells + 4 * rank * 3 * s.nodes,
            {"RANK": rank}, variant=name,
        ),
    )  # fmt: skip


_DENSITY_AT_NODES = _at_nodes("density", DENSITY, 2, "looked_at")
_COLOUR_AT_NODES = _at_nodes("colour", COLOUR, 1, "lit")

SEEN = Op(
    (
        Kernel(
            "field", "harmonics", "along rays", False, blocks(_RAYS, 256), lambda s, _: s.rays * (12 + 4 * TERMS),
            {"COUNT": TERMS}, apart=loaded(6, 12) + stored(18, 4 * TERMS),
        ),
        # Samples of a ray lie beside each other in memory, and a warp has four of them.
        Kernel(
            "field", "optical_depths", "densities", False, blocks(lambda s: s.all_samples, 32),
            lambda s, _: 20 * s.all_samples + 24 * s.rays + s.read(s.all_samples, DENSITY),
            {"RANK": DENSITY}, loads="l2",
        ),
        Kernel(
            "field", "weigh", "along rays", False, _RAYS,
            lambda s, _: 16 * s.all_samples + 4 * s.all_lit + 52 * s.rays, loops=_per_ray("samples", _OF_RAY),
            loads="memory", longest=_longest("samples", _OF_RAY),
        ),
        Kernel(
            "field", "shade", "colours", False, _RAYS,
            lambda s, _: 24 * s.all_lit + (4 * _LIGHTS + 52) * s.rays + s.read(s.all_lit, COLOUR),
            {"RANK": COLOUR}, _per_ray("lit", _SHADED), loads="l2", longest=_longest("lit", _SHADED),
        ),
        Kernel(
            "field", "weigh_backward", "along rays", True, _RAYS,
            lambda s, _: 20 * s.all_looked_at + 12 * s.all_lit + 32 * s.rays, loops=_per_ray("looked_at", _OF_RAY),
            loads="memory", longest=_longest("looked_at", _OF_RAY),
        ),
        _FIND_CELLS,
        # Each sample's gradients by its planes and lines, three modes of both, are written; rays get six numbers from
        # each part.
        Kernel(
            "field", "spread", "to planes and lines", True, lambda s: _PARTS * s.rays,
            lambda s, _: (8 + 24 * DENSITY) * s.all_looked_at + (32 + 24 * _PARTS) * s.rays
            + s.read(s.all_looked_at, DENSITY),
            {"COLOUR": 0, "WANTED": True, "RANK": DENSITY}, _per_ray("looked_at", _SPREAD_DENSITY), loads="l2",
            longest=_longest("looked_at", _SPREAD_DENSITY), variant="density",
        ),
        *_DENSITY_AT_NODES,
        Kernel(
            "field", "spread", "to planes and lines", True, lambda s: _PARTS * s.rays,
            lambda s, _: (24 + 24 * COLOUR) * s.all_lit + (32 + 24 * _PARTS + 8 * _LIGHTS) * s.rays
            + s.read(s.all_lit, COLOUR),
            {"COLOUR": 1, "WANTED": True, "RANK": COLOUR}, _per_ray("lit", _SPREAD_COLOUR), loads="l2",
            longest=_longest("lit", _SPREAD_COLOUR), variant="colour",
        ),
        *_COLOUR_AT_NODES,
        Kernel(
            "field", "harmonics_backward", "along rays", True, blocks(_RAYS, 256),
            lambda s, _: s.rays * (24 + 4 * TERMS), {"COUNT": TERMS}, apart=loaded(16, 4 * TERMS) + loaded(6, 12)
            + stored(6, 12),
        ),
    ),
    (
        # The matrix in another order, and a product of it with each ray's harmonics.
        OtherWork("lights", "along rays", False, lambda s: 4 * (TERMS + _LIGHTS) * s.rays, lambda s: 2),
        # Numbers of all samples, the ray of each by bisection, one less, and none below zero.
        OtherWork("ray of each sample", "densities", False, lambda s: 36 * s.all_samples, lambda s: 4),
        OtherWork("lights", "along rays", True, lambda s: 4 * (2 * TERMS + 2 * _LIGHTS) * s.rays, lambda s: 4),
        *_SORTED,
        OtherWork("sum of parts", "along rays", True, lambda s: 24 * (2 * _PARTS + 1) * s.rays, lambda s: 1),
    ),
)  # fmt: skip

# ---- beside what rays see ----

DENSITIES = Op(
    (
        Kernel(
            "field", "densities", "empty cells", False, blocks(lambda s: s.all_samples, 32),
            lambda s, _: 16 * s.all_samples + s.read(s.all_samples, DENSITY), {"RANK": DENSITY}, loads="l2",
            apart=loaded(3, 12),
        ),
    )
)  # fmt: skip


def _of_features(name: str, backward: bool, variant: str, rank: int) -> Kernel:
    """A kernel that reads points, or writes their gradients, in programs for blocks of points and three modes."""
    columns = 2 * 3 * rank if backward else 0
    return Kernel(
        "field", name, "features", backward, lambda s: _PARTS * math.ceil(s.all_samples * rank / 256),
        lambda s, _: s.all_samples * (12 + 4 * (3 * rank + columns)) + s.read(s.all_samples, rank),
        {"RANK": rank}, loads="l2", variant=variant,
    )  # fmt: skip


def _featured(kernel: Kernel) -> Kernel:
    """A kernel of the gradient, as a part of the features'. All points count for both grids, which is a constant added
    to an address and no other code."""
    return replace(kernel, stage="features")


FEATURES = Op(
    (
        *(_of_features("products", False, name, rank) for name, rank in (("density", DENSITY), ("colour", COLOUR))),
        _featured(_FIND_CELLS),
        *(
            _of_features("spread_products", True, name, rank)
            for name, rank in (("density", DENSITY), ("colour", COLOUR))
        ),
        *map(_featured, (*_DENSITY_AT_NODES, *_COLOUR_AT_NODES)),
    ),
    (
        OtherWork("points as rays", "features", True, lambda s: 12 * s.all_samples, lambda s: 3),
        *(replace(one, stage="features") for one in _SORTED),
    ),
)

# ---- the training step ----

TRAINING = Op(
    others=(
        # Fused: the gradient is read, a parameter and two moments are read and written. Five tensors are checked, of
        # which the gradients by the grid are large.
        OtherWork("Adam", "Adam", True, lambda s: 28 * s.parameters, lambda s: 2),
        OtherWork("checks", "Adam", True, lambda s: 8 * s.parameters, lambda s: 30),
        # Every fourth step the planes' differences along both axes: three numbers for each, two for its square, one
        # for the mean; backward three, two to multiply and six to add; and zeros. Its launches are among the small
        # operations.
        OtherWork("smoothness", "smoothness", True, lambda s: 0.25 * 4 * (2 * 17 + 1) * s.parameters, lambda s: 0),
        OtherWork("small operations", "small operations", True, lambda s: 0, lambda s: s.torch_ops),
    )
)
