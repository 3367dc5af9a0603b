"""Pixels of the training photographs, and the rays behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView


@dataclass(frozen=True, eq=False)
class Pixels:
    """P pixels. views: (P,) int64. places: (P, 2), x and y of their centres, pixels. colours: (P, 3), encoded."""

    views: Tensor
    places: Tensor
    colours: Tensor


class CameraTable:
    """The cameras of V views as tensors."""

    def __init__(self, cameras: Sequence[Camera]):
        to_world = np.stack([camera.camera_to_world for camera in cameras])
        self._rotations = torch.from_numpy(to_world[:, :3, :3]).float()
        self._centres = torch.from_numpy(to_world[:, :3, 3].copy()).float()
        self._intrinsics = torch.tensor([camera.parameters for camera in cameras], dtype=torch.float32)

    def rays(self, views: Tensor, places: Tensor, shift: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """World origins and directions (R, 3) behind places (R, 2), pixels, of views (R,); differentiable. The
        directions' z in the camera's frame is 1. shift: (R, 2), scene units, by which the origins lie beside the
        cameras' centres, along their x and y axes."""
        intrinsics, rotations = self._intrinsics[views], self._rotations[views]
        slope = (places - intrinsics[:, 2:]) / intrinsics[:, :2]
        directions = (rotations[:, :, :2] @ slope[:, :, None])[:, :, 0] + rotations[:, :, 2]
        origins = self._centres[views]
        if shift is not None:
            origins = origins + (rotations[:, :, :2] @ shift[:, :, None])[:, :, 0]
        return origins, directions


class TrainingPixels:
    """All pixels of the training photographs, in a random order that is drawn anew when all were used."""

    def __init__(self, views: Sequence[TrainingView], random: np.random.Generator):
        self._random = random
        sizes = [(view.camera.width, view.camera.height) for view in views]
        self._widths = np.array([width for width, _ in sizes])
        self._starts = np.cumsum([0, *(width * height for width, height in sizes)])
        images = [np.ascontiguousarray(view.image, np.float32).reshape(-1, 3) for view in views]
        self._colours = torch.from_numpy(np.concatenate(images))
        self._order, self._next = np.empty(0, np.int64), 0

    def draw(self, count: int) -> Pixels:
        """The next `count` pixels of the order, or all if there are fewer."""
        if self._next + count > len(self._order):
            self._order, self._next = self._random.permutation(int(self._starts[-1])), 0
        chosen = self._order[self._next : self._next + count]
        self._next += count
        views = np.searchsorted(self._starts, chosen, side="right") - 1
        within, widths = chosen - self._starts[views], self._widths[views]
        places = np.stack([within % widths, within // widths], axis=1) + 0.5
        numbers = torch.from_numpy(chosen)
        return Pixels(torch.from_numpy(views), torch.from_numpy(places).float(), self._colours[numbers])


def whole_image(camera: Camera) -> Tensor:
    """(H W, 2): x and y of the centres of all pixels, row after row."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    return torch.from_numpy(np.stack([columns.reshape(-1), rows.reshape(-1)], axis=1)).float()
