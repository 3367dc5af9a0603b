"""The gradient of `rasterize` on a GPU: of blending, summed over each Gaussian's intersections, and of projection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from dofbench.runtime.gpu_launch import kernels, launch
from dofbench.runtime.raster import ViewStatistics

from .gpu_inputs import Settings
from .gpu_lists import Lists

_GAUSSIANS = 128  # of a program that goes from sums to parameters
_SUMMED = 4  # Gaussians of a program that sums, one for each warp
_ROWS = 8  # intersections of each of them that are read at once


class Slot(NamedTuple):
    """Where in an intersection's contribution the sums lie that aren't always wanted, and how long it is."""

    absolute: int
    normal: int
    length: int


def slot_of(level: int, moved: bool, absolute: bool) -> Slot:
    """The contribution for a level of geometry, with three products by points of a lens or three sums by ray length,
    with sums of absolute values and of normals, as far as they are wanted; see `gpu_layout`."""
    first = 9 + 3 * (level > 0 or moved)
    second = first + 2 * absolute
    return Slot(first, second, second + 3 * (level > 1))


def gradients(
    settings: Settings, statistics: ViewStatistics | None, lists: Lists, parameters: tuple[Tensor, ...],
    blur: Tensor | None, radius: Tensor | None, outputs: Sequence[Tensor | None], blended: tuple[Tensor | None, ...],
    by_outputs: Sequence[Tensor | None], levels: Sequence[int],
) -> list[Tensor | None]:  # fmt: skip
    """The gradients with respect to blur and radius, None where there is none, and by the six parameters; fills in
    `statistics`.

    outputs: what blending drew. by_outputs: the gradients with respect to them, None where the loss uses none. levels:
    of geometry that they belong to. blended: what blending kept besides, see `gpu_blend.blend`."""
    view = settings.view
    n = parameters[0].shape[0]
    used = sum(1 << k for k, gradient in enumerate(by_outputs) if gradient is not None)
    # Gradients are computed only for the outputs that the loss uses.
    level = max((level for k, level in enumerate(levels) if used >> k & 1), default=0)
    want_abs = statistics is not None and statistics.want_abs
    slot = slot_of(level, settings.moved, want_abs)
    contributions = view.new_zeros(lists.ids.numel(), slot.length)
    _blend_backward(settings, lists, radius, outputs, blended, by_outputs, used, level, want_abs, slot, contributions)
    sums = view.new_empty(n, slot.length)
    launch(
        kernels("rasterize.gpu_project_backward").sum_slots, (-(-n // _SUMMED),), contributions, lists.order,
        lists.ends, sums, n, settings.views, warps=_SUMMED,
        SLOT=slot.length, COLUMNS=16 if slot.length <= 16 else 32, GAUSSIANS=_SUMMED, ROWS=_ROWS,
    )  # fmt: skip
    by_means, by_scales, by_quaternions, by_logits, by_dc = (torch.empty_like(each) for each in parameters[:5])
    terms = (settings.degree + 1) ** 2 - 1
    sh_rest = parameters[5]
    by_rest = torch.empty_like(sh_rest) if terms == sh_rest.shape[1] else torch.zeros_like(sh_rest)
    by_blur = None if blur is None else torch.empty_like(blur)
    by_radius = view.new_empty(n) if settings.moved else None
    grad_2d = None if statistics is None else view.new_empty(n, 2)
    grid = (-(-n // _GAUSSIANS),)
    launch(
        kernels("rasterize.gpu_project_backward").project_backward, grid, *parameters[:4],
        *settings.given(settings.filter_3d, blur), view, lists.visible, sums,
        by_means, by_scales, by_quaternions, by_logits, *settings.given(by_blur, by_radius, grad_2d), n,
        LEVEL=level, FADES=settings.fades, FILTERED=settings.filter_3d is not None, BLURRED=blur is not None,
        MOVED=settings.moved, STATISTICS=statistics is not None, S_NORMAL=slot.normal, SLOT=slot.length,
        BLOCK=_GAUSSIANS,
    )  # fmt: skip
    launch(
        kernels("rasterize.gpu_color").color_backward, grid, parameters[0], sh_rest, view, lists.visible,
        lists.records, sums, by_means, by_dc, by_rest, n,
        SLOT=slot.length, REST=sh_rest.shape[1], TERMS=terms, BLOCK=_GAUSSIANS,
    )  # fmt: skip
    if statistics is not None:
        statistics.grad_2d = grad_2d
        if want_abs:
            statistics.abs_grad_2d = sums[:, slot.absolute : slot.absolute + 2].contiguous()
    return [by_blur, by_radius, by_means, by_scales, by_quaternions, by_logits, by_dc, by_rest]


def _blend_backward(
    settings: Settings, lists: Lists, radius: Tensor | None, outputs: Sequence[Tensor | None],
    blended: tuple[Tensor | None, ...], by_outputs: Sequence[Tensor | None], used: int, level: int, want_abs: bool,
    slot: Slot, contributions: Tensor,
) -> None:  # fmt: skip
    """Write every intersection's contribution."""
    color, alpha, depth, _, normal, distortion = outputs
    looked_at, kept, median_at, mean_inverse = blended
    assert kept is not None
    images = (color, alpha, depth, median_at, normal, distortion, mean_inverse)
    tiles = settings.columns * settings.rows
    gradients = (None if each is None else each.contiguous() for each in by_outputs)
    # All pixels of a tile in one warp: sums over them need no memory that warps share, nor do warps wait.
    launch(
        kernels("rasterize.gpu_blend_backward").blend_backward, (kept.shape[0],), lists.records,
        *settings.given(radius), settings.view, lists.starts, lists.ids, lists.slots, looked_at, kept,
        *settings.given(*images), *settings.given(*gradients), contributions, used, settings.width, settings.height,
        tiles, tiles * settings.views, (tiles * settings.views).bit_length(), warps=1,
        EACH=kept.shape[1], LEVEL=level, MOVED=settings.moved, ABSOLUTE=want_abs, S_ABSOLUTE=slot.absolute,
        S_NORMAL=slot.normal, SLOT=slot.length,
    )  # fmt: skip
