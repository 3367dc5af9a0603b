"""Pixels of the training views, and their rays."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView
from dofbench.core.errors import InputError
from dofbench.core.stored_image import StoredImage
from dofbench.runtime.device_numbers import sent
from dofbench.training.common.monitor import Place


@dataclass(frozen=True, eq=False)
class Pixels:
    """P pixels. views: (P,) int64. places: (P, 2), x and y of their centres, px. colours: (P, 3), encoded.

    view: of all pixels, if they were drawn from one. width: of a patch, px. Both are the host's numbers. valid: (P,)
    bool, the unmasked pixels of a patch; None where all are valid.
    """

    views: Tensor
    places: Tensor
    colours: Tensor
    view: int | None = None
    width: int | None = None
    valid: Tensor | None = None

    def at(self, chosen: Tensor) -> Pixels:
        """Some of the pixels, by their numbers (Q,) int64."""
        return Pixels(self.views[chosen], self.places[chosen], self.colours[chosen], self.view)

    def without_masked(self, colours: Tensor) -> Tensor:
        """Replace predicted colours (..., P, 3) by the views' where masked: no error and no gradient there."""
        return colours if self.valid is None else torch.where(self.valid[:, None], colours, self.colours)


class CameraTable:
    """The cameras of V views as tensors. sizes: (V, 2), width and height, px. widths: on the host."""

    def __init__(self, cameras: Sequence[Camera], device: torch.device | str = "cpu"):
        to_world = np.stack([camera.camera_to_world for camera in cameras])
        self._rotations = sent(to_world[:, :3, :3], device)
        self._centres = sent(to_world[:, :3, 3], device)
        self._intrinsics = sent([camera.parameters for camera in cameras], device)
        self.sizes = sent([(camera.width, camera.height) for camera in cameras], device)
        self.widths = [camera.width for camera in cameras]

    @property
    def focal(self) -> Tensor:
        """(V, 2) focal lengths along x and y, px."""
        return self._intrinsics[:, :2]

    def rays(
        self, views: Tensor, places: Tensor, shift: Tensor | None = None, tilt: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """World origins and directions (R, 3) of places (R, 2), px, of views (R,), with z = 1 in the camera's frame;
        differentiable.

        shift: (R, 2), scene units, of the origins along the cameras' x and y axes. tilt: (R, 2), added to the
        directions' x and y in the cameras' frames.
        """
        intrinsics, rotations = self._intrinsics[views], self._rotations[views]
        slope = (places - intrinsics[:, 2:]) / intrinsics[:, :2]
        if tilt is not None:
            slope = slope + tilt
        directions = (rotations[:, :, :2] @ slope[:, :, None])[:, :, 0] + rotations[:, :, 2]
        origins = self._centres[views]
        if shift is not None:
            origins = origins + (rotations[:, :, :2] @ shift[:, :, None])[:, :, 0]
        return origins, directions


class _Colours:
    """The colours of all pixels, one view after the other: 8-bit levels if all views are kept as these."""

    def __init__(self, stored: Sequence[StoredImage], device: torch.device | str):
        table = stored[0].table
        alike = all(one.table is table for one in stored)
        parts = [one.values if alike else np.asarray(one.floats(), np.float32) for one in stored]
        self._values = torch.from_numpy(np.concatenate([part.reshape(-1, 3) for part in parts])).to(device)
        self._table = torch.from_numpy(table).to(device) if alike and table is not None else None

    def __getitem__(self, numbers: Tensor) -> Tensor:
        """(P, 3) float32, of pixels by their numbers (P,) int64."""
        found = self._values[numbers]
        return found if self._table is None else self._table[found.int()]


class TrainingPixels:
    """The pixels of the training views. Masked pixels are drawn only as parts of a patch.

    Pixels are drawn on the host, the same on every device; their colours are looked up on the device.
    """

    def __init__(self, views: Sequence[TrainingView], random: np.random.Generator, device: torch.device | str = "cpu"):
        self._random, self._device, self._views = random, device, views
        self._sizes = np.array([(view.camera.width, view.camera.height) for view in views])
        self._starts = np.cumsum([0, *self._sizes.prod(axis=1)])
        if self._starts[-1] >= 2**32:
            raise InputError("training views", f"{self._starts[-1]} pixels", "fewer than 2^32 for a radiance field")
        self._colours = _Colours([view.stored for view in views], device)
        self._order, self._next = np.empty(0, np.uint32), 0
        self._drawn_by: np.random.Generator | None = None  # the generator before it drew the order
        self._round: list[int] = []

    def state(self) -> tuple[np.random.Generator, np.random.Generator | None, int, list[int]]:
        """The order in which pixels and views are drawn, for `restore`."""
        return self._random, self._drawn_by, self._next, self._round

    def restore(self, state: tuple[np.random.Generator, np.random.Generator | None, int, list[int]]) -> None:
        """Go on in the order of an earlier `state`."""
        self._random, self._drawn_by, self._next, self._round = state
        if self._drawn_by is not None:
            self._order = self._ordered(copy.deepcopy(self._drawn_by))

    def __deepcopy__(self, memo: dict[int, Any]) -> TrainingPixels:
        """Shares what nobody changes: the colours, and the order, which is drawn anew as a whole."""
        twin = copy.copy(self)
        memo[id(self)] = twin
        twin._random, twin._round = copy.deepcopy(self._random, memo), list(self._round)
        return twin

    def check(self, step: int) -> None:
        """Raise NonFiniteError unless all colours are finite. A step draws few pixels of every view, so without this a
        training may run for long before it fails."""
        for view in self._views:
            if view.stored.table is None:  # 8-bit levels are finite
                Place(step, view.name).check(torch.from_numpy(np.asarray(view.image, np.float32)), "photograph")

    def draw(self, count: int) -> Pixels:
        """Draw `count` pixels of all views, or all if there are fewer, in a random order that is drawn anew at its
        end."""
        if self._next + count > len(self._order):
            self._drawn_by, self._next = copy.deepcopy(self._random), 0
            self._order = np.empty(0, np.uint32)  # freed before the next one is there
            self._order = self._ordered(self._random)
        chosen = self._order[self._next : self._next + count]
        self._next += count
        return self._pixels(chosen.astype(np.int64))

    def draw_view(self, count: int) -> Pixels:
        """Draw `count` different pixels of one view, or all if it has fewer, in rounds of all views."""
        view = self._next_view()
        valid = self._valid(view)
        drawn = self._random.permutation(int(self._sizes[view].prod()) if valid is None else valid)
        return self._pixels(self._starts[view] + drawn[:count], view)

    def whole_view(self, view: int) -> Pixels:
        """All pixels of a view as one patch, masked ones too."""
        width, height = (int(size) for size in self._sizes[view])
        return self._pixels(self._starts[view] + np.arange(width * height), view, width)

    def draw_patch(self, side: int) -> Pixels:
        """Draw a patch of one view, row after row, `side` px high and wide or as much as the view has, with at least
        one valid pixel."""
        view = self._next_view()
        width, height = (int(size) for size in self._sizes[view])
        valid = self._valid(view)
        if valid is None:
            left, top = (int(self._random.integers(max(length - side, 0) + 1)) for length in (width, height))
        else:
            row, column = divmod(int(self._random.choice(valid)), width)
            left, top = self._around(column, side, width), self._around(row, side, height)
        rows, columns = np.mgrid[top : min(top + side, height), left : min(left + side, width)]
        within = (rows * width + columns).reshape(-1)
        pixels = self._pixels(self._starts[view] + within, view, columns.shape[1])
        if valid is None:
            return pixels
        return replace(pixels, valid=torch.from_numpy(np.isin(within, valid)).to(self._device))

    def _around(self, place: int, side: int, length: int) -> int:
        """A random start of `side` pixels, or all, of a line of `length`, with `place` among them."""
        return int(self._random.integers(max(0, place - side + 1), min(place, max(length - side, 0)) + 1))

    def _valid(self, view: int) -> np.ndarray | None:
        """The numbers of a view's valid pixels within it; None without a mask."""
        mask = self._views[view].mask
        return None if mask is None else np.flatnonzero(mask)

    def _ordered(self, random: np.random.Generator) -> np.ndarray:
        """(P,) uint32: all valid pixels in a random order."""
        if all(view.mask is None for view in self._views):
            order = np.arange(self._starts[-1], dtype=np.uint32)
        else:
            valid = (self._valid(view) for view in range(len(self._views)))
            pairs = zip(self._starts[:-1], self._sizes.prod(axis=1), valid, strict=True)
            order = np.concatenate(
                [(start + (np.arange(size) if own is None else own)).astype(np.uint32) for start, size, own in pairs]
            )
        random.shuffle(order)
        return order

    def _next_view(self) -> int:
        if not self._round:
            self._round = [int(view) for view in self._random.permutation(len(self._sizes))]
        return self._round.pop()

    def _pixels(self, chosen: np.ndarray, view: int | None = None, width: int | None = None) -> Pixels:
        views = np.searchsorted(self._starts, chosen, side="right") - 1
        within, widths = chosen - self._starts[views], self._sizes[views, 0]
        places = np.stack([within % widths, within // widths], axis=1) + 0.5
        numbers, of_views = (torch.from_numpy(one).to(self._device, non_blocking=True) for one in (chosen, views))
        return Pixels(of_views, sent(places, self._device), self._colours[numbers], view, width)


def whole_image(camera: Camera, device: torch.device | str = "cpu") -> Tensor:
    """(H W, 2): x and y of all pixels' centres, row after row."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    return sent(np.stack([columns.reshape(-1), rows.reshape(-1)], axis=1), device)
