"""What the ops on whole pictures do: the tone curve, circles of confusion, the losses of colour and depth, and mixtures
of neighbouring pixels."""

from __future__ import annotations

import math

from gpu_work import Kernel, Loop, Op, OtherWork, blocks, loaded, stored

MIX = 9  # width of the mixed neighbourhood, BAGS' middle scale
_LOSS = {"WEIGHTED": False, "WEIGH_ALL": False, "L1": True, "EDGES": True}
_MIXED = blocks(lambda s: s.pixels, 128)
_AROUND = lambda s: MIX * MIX  # noqa: E731


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


TONE = Op(
    (
        Kernel(
            "tone", "power", "lens forward", False, blocks(lambda s: s.numbers, 1024), lambda s, _: 8 * s.numbers,
        ),
        Kernel(
            "tone", "power_gradient", "lens backward", True, blocks(lambda s: s.numbers, 1024),
            lambda s, _: 16 * s.numbers,
        ),
    )
)  # fmt: skip

SSIM = Op(
    (
        _image_kernel("filter_images_along_rows", False, 2 + 4, 5),
        _image_kernel("compare", False, 4 + 2 + 3, 9, **_LOSS),
        _image_kernel("filter_slopes_along_rows", True, 3 + 3, 7),
        _image_kernel("gradient", True, 3 + 2 + 1, 7, **_LOSS),
    ),
    (
        OtherWork("means", "loss", False, lambda s: 0, lambda s: 6),
        OtherWork("scales", "loss", True, lambda s: 0, lambda s: 6),
    ),
)

_SURFACE = blocks(lambda s: s.pixels, 1024)
_SAMPLES = blocks(lambda s: s.pixels, 256)


def _sums(stage: str, backward: bool = True, launches: int = 1) -> OtherWork:
    """What torch makes of the programs' sums."""
    return OtherWork("sums", stage, backward, lambda s: 0, lambda s: launches)


def _surface_kernel(name: str, stage: str, backward: bool, numbers: int) -> Kernel:
    """numbers: that are read and written for a pixel."""
    return Kernel("surface", name, stage, backward, _SURFACE, lambda s, _: 4 * numbers * s.pixels)


SURFACE = Op(
    (
        _surface_kernel("disparities", "lens forward", False, 3),
        _surface_kernel("fill", "lens forward", False, 3),
        _surface_kernel("disparities_gradient", "lens backward", True, 4),
        _surface_kernel("circles", "lens forward", False, 2),
        _surface_kernel("circles_gradient", "lens backward", True, 3),
    ),
    (_sums("lens backward"),),
)

# A sample in every pixel, as the depth prior has, at most: its place, depth and share, and what is rendered there.
_DEPTH = {"INVERSE": True, "SQUARED": False, "SHARED": True, "WEIGHTED": False}
KNOWN_DEPTH = Op(
    (
        Kernel("surface", "depth_error", "loss", False, _SAMPLES, lambda s, _: 32 * s.pixels, _DEPTH),
        Kernel("surface", "depth_error_gradient", "loss", True, _SAMPLES, lambda s, _: 52 * s.pixels, _DEPTH),
    ),
    (_sums("loss", False, 3), OtherWork("zeros", "loss", True, lambda s: 4 * s.pixels, lambda s: 1)),
)

# Three channels of neighbouring pixels lie 12 bytes apart.
COLOURS = Op(
    (
        Kernel(
            "colours", "changed", "loss", False, blocks(lambda s: s.pixels, 512), lambda s, _: 8 * s.numbers,
            apart=loaded(3, 12) + stored(3, 12),
        ),
        Kernel(
            "colours", "gradient", "loss", True, blocks(lambda s: s.pixels, 512), lambda s, _: 12 * s.numbers,
            apart=loaded(6, 12) + stored(3, 12),
        ),
    ),
    (_sums("loss"),),
)  # fmt: skip

# Logits of neighbouring pixels lie 4 * 81 bytes apart, so that every load of a warp touches 32 lines.
MIXTURE = Op(
    (
        Kernel(
            "mix", "mixed", "mix", False, _MIXED, lambda s, _: s.pixels * (12 + 4 * MIX * MIX + 12 + 8),
            {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 1, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
            apart=loaded(2 * MIX * MIX, 4 * MIX * MIX),
        ),
        Kernel(
            "mix", "by_logits", "mix", True, _MIXED, lambda s, _: s.pixels * (8 * MIX * MIX + 12 + 12 + 8 + 12),
            {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 2, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
            apart=loaded(MIX * MIX, 4 * MIX * MIX) + stored(MIX * MIX, 4 * MIX * MIX),
        ),
        Kernel(
            "mix", "by_image", "mix", True, _MIXED, lambda s, _: s.pixels * (4 * MIX * MIX + 8 + 12 + 12),
            {"SIZE": MIX, "CHANNELS": 3}, (Loop("MUFU", 2, _AROUND, exact=True), Loop("BRA", 1, lambda s: MIX)),
            apart=loaded(MIX * MIX, 4 * MIX * MIX),
        ),
    )
)  # fmt: skip
