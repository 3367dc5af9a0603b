"""Projection on a GPU, and every tile's list of Gaussians, nearest first."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.gpu_launch import kernels, launch

from .gpu_inputs import BAD, RECORD, Settings
from .op import explain

_GAUSSIANS = 128  # of a program that projects
_INTERSECTIONS = 256  # of a program that fills lists


class Lists(NamedTuple):
    """The Gaussians of one call as its images see them, and its tiles' lists.

    records: (N, RECORD), see gpu_layout. visible: (N,) bool, in any image. radii: (N,), pixels. starts: (tiles + 1,),
    over all images' tiles: where each one's list begins in ids, the Gaussians, and slots, the intersections' numbers
    before sorting. order: (N,), the Gaussians, nearest first. ends: (N * images,), where the intersections of each of
    them in each image end, as they are numbered before sorting.
    """

    records: Tensor
    visible: Tensor
    radii: Tensor
    starts: Tensor
    ids: Tensor
    slots: Tensor
    order: Tensor
    ends: Tensor


def project_and_list(
    settings: Settings, blur: Tensor | None, radius: Tensor | None, parameters: tuple[Tensor, ...]
) -> Lists:
    """Project the Gaussians and list those of every tile.

    Waits for the GPU once, for the number of intersections. Lists of a guessed length wouldn't have to wait, but would
    silently leave Gaussians out where the guess is too low, and sort what isn't there where it is too high. As one
    number is read anyway, it reports Gaussians that aren't finite too.

    Raises FloatingPointError and ValueError for such Gaussians as `op.rasterize` does, and InputError for more
    intersections than can be numbered.
    """
    means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest = parameters
    view, views, n, rest = settings.view, settings.views, means.shape[0], sh_rest.shape[1]
    records = means.new_empty(n, RECORD)
    depths, radii = means.new_empty(n), means.new_empty(n)
    visible = means.new_empty(n, dtype=torch.bool)
    counts = means.new_empty((n, views), dtype=torch.int32)
    grid = (-(-n // _GAUSSIANS),)
    moved_by, blur_by, filtered_by = settings.given(radius, blur, settings.filter_3d)
    launch(
        kernels("rasterize.gpu_project").project, grid, means, log_scales, quaternions, opacity_logits, filtered_by,
        blur_by, moved_by, view, records, depths, radii, n,
        GEOMETRY=settings.geometry, FADES=settings.fades, FILTERED=settings.filter_3d is not None,
        BLURRED=blur is not None, MOVED=settings.moved, BLOCK=_GAUSSIANS,
    )  # fmt: skip
    tiling = kernels("rasterize.gpu_tiles")
    launch(
        tiling.count, grid, records, moved_by, view, radii, visible, counts, n, views,
        MOVED=settings.moved, BLOCK=_GAUSSIANS,
    )  # fmt: skip
    launch(
        kernels("rasterize.gpu_color").color, grid, means, sh_dc, sh_rest, view, visible, records, counts, n, views,
        REST=rest, TERMS=(settings.degree + 1) ** 2 - 1, BLOCK=_GAUSSIANS,
    )  # fmt: skip
    # Intersections are numbered by depth, Gaussian and image, and within them in the order of the tiles. So those of
    # one Gaussian are adjacent, and a stable sort by tile alone leaves each tile's list in order of depth. All points
    # of a lens lie in one plane parallel to the image, so the order of depth is the same from all of them.
    order = torch.sort(depths, stable=True).indices
    ends = counts.index_select(0, order).view(-1).cumsum(0)
    total = int(ends[-1]) if n else 0
    if total >= BAD:
        worst = int(counts[:, 0].argmax())
        if int(counts[worst, 0]) == BAD:
            raise explain(worst, parameters, settings.filter_3d, blur, radius)
        found = f"{total} places where Gaussians meet tiles"
        raise InputError("kernel rasterize", found, f"fewer than {BAD}: fewer Gaussians, pixels or aperture samples")
    tiles = settings.columns * settings.rows * views
    # A radix sort's time goes with the length of its keys.
    kind = torch.int16 if tiles < 2**15 else torch.int32
    numbers = means.new_empty(total, dtype=kind)
    owners = means.new_empty(total, dtype=torch.int32)
    launch(
        tiling.fill, (-(-total // _INTERSECTIONS),), records, moved_by, view, order, ends, numbers, owners,
        total, n * views, (n * views).bit_length(), views, settings.columns, settings.rows,
        MOVED=settings.moved, BLOCK=_INTERSECTIONS,
    )  # fmt: skip
    numbers, slots = torch.sort(numbers, stable=True)
    every = torch.arange(tiles + 1, dtype=kind, device=means.device)
    starts = torch.searchsorted(numbers, every, out_int32=True)
    return Lists(records, visible, radii, starts, owners.index_select(0, slots), slots, order, ends)
