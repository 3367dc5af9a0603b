"""Pixels of the training views, and their rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView
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


class TrainingPixels:
    """The pixels of the training views. Masked pixels are drawn only as parts of a patch.

    Pixels are drawn on the host, the same on every device; their colours are looked up on the device.
    """

    def __init__(self, views: Sequence[TrainingView], random: np.random.Generator, device: torch.device | str = "cpu"):
        self._random, self._device = random, device
        self._sizes = np.array([(view.camera.width, view.camera.height) for view in views])
        self._starts = np.cumsum([0, *self._sizes.prod(axis=1)])
        images = [np.ascontiguousarray(view.image, np.float32).reshape(-1, 3) for view in views]
        self._photographs = np.concatenate(images)
        self._colours = torch.from_numpy(self._photographs).to(device)
        self._names = [view.name for view in views]
        self._valid = [None if view.mask is None else np.flatnonzero(view.mask) for view in views]
        self._all = self._unmasked()
        self._order, self._next = np.empty(0, np.int64), 0
        self._round: list[int] = []

    def state(self) -> tuple[np.random.Generator, np.ndarray, int, list[int]]:
        """The order in which pixels and views are drawn, for `restore`."""
        return self._random, self._order, self._next, self._round

    def restore(self, state: tuple[np.random.Generator, np.ndarray, int, list[int]]) -> None:
        """Go on in the order of an earlier `state`."""
        self._random, self._order, self._next, self._round = state

    def check(self, step: int) -> None:
        """Raise NonFiniteError unless all colours are finite. A step draws few pixels of every view, so without this a
        training may run for long before it fails."""
        for name, start, end in zip(self._names, self._starts[:-1], self._starts[1:], strict=True):
            Place(step, name).check(torch.from_numpy(self._photographs[start:end]), "photograph")

    def draw(self, count: int) -> Pixels:
        """Draw `count` pixels of all views, or all if there are fewer, in a random order that is drawn anew at its
        end."""
        if self._next + count > len(self._order):
            self._order, self._next = self._random.permutation(self._all), 0
        chosen = self._order[self._next : self._next + count]
        self._next += count
        return self._pixels(chosen)

    def draw_view(self, count: int) -> Pixels:
        """Draw `count` different pixels of one view, or all if it has fewer, in rounds of all views."""
        view = self._next_view()
        valid = self._valid[view]
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
        valid = self._valid[view]
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

    def _unmasked(self) -> int | np.ndarray:
        """The argument of `permutation` to draw all valid pixels: their number if none is masked, else an array."""
        if all(valid is None for valid in self._valid):
            return int(self._starts[-1])
        pairs = zip(self._starts[:-1], self._sizes.prod(axis=1), self._valid, strict=True)
        return np.concatenate([start + (np.arange(size) if own is None else own) for start, size, own in pairs])

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
