"""Known depth of a view, kept as small as it can be: as samples, or as a map of which only known pixels are kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera

_MOST_PIXELS = 2**31 - 1  # of an image whose rows and columns are numbered by 32 bits


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """rows, columns: (M,) int32 pixels; depth: (M,) float32 z in scene units. weight: (M,), or None for equal
    weights. most: the largest number in one pixel if the samples are in the order of rows, then columns; else None."""

    rows: Tensor
    columns: Tensor
    depth: Tensor
    weight: Tensor | None = None
    most: int | None = None

    def within(self, mask: Tensor) -> DepthSamples:
        """The samples at pixels where mask (H, W) is true, on the host."""
        kept = mask[self.rows, self.columns]
        weight = None if self.weight is None else self.weight[kept]
        return DepthSamples(self.rows[kept], self.columns[kept], self.depth[kept], weight, self.most)

    def on(self, device: str) -> DepthSamples:
        """The samples on a device, in the order of rows, then columns."""
        if self.most is not None:
            return self._mapped(lambda one: one.to(device), self.most)
        rows_first = self.rows.numpy(force=True).astype(np.int64) << 32 | self.columns.numpy(force=True)
        order = torch.from_numpy(np.argsort(rows_first, kind="stable")).to(self.rows.device)
        _, many = np.unique(rows_first, return_counts=True)
        return self._mapped(lambda one: one[order].to(device), int(many.max(initial=1)))

    def _mapped(self, change: Callable[[Tensor], Tensor], most: int) -> DepthSamples:
        weight = None if self.weight is None else change(self.weight)
        return DepthSamples(change(self.rows), change(self.columns), change(self.depth), weight, most)


class PositiveMap:
    """Numbers above 0 at some pixels of an image, of which only these are kept, and a bit for every pixel.

    `PositiveMap(values)`: (H, W); what isn't above 0 counts as 0. shape: (H, W). numbers: (M,) float32, row by row.
    """

    def __init__(self, values: np.ndarray):
        there = values > 0
        self.shape = values.shape[0], values.shape[1]
        # Tensors, since a checkpoint writes these without a copy.
        self._bits = torch.from_numpy(np.packbits(there))
        self.numbers = torch.from_numpy(values[there].astype(np.float32))

    @property
    def there(self) -> np.ndarray:
        """(H, W) bool: where the numbers are."""
        return np.unpackbits(self._bits.numpy(), count=self.shape[0] * self.shape[1]).view(bool).reshape(self.shape)

    def whole(self, numbers: Tensor | None = None) -> np.ndarray:
        """(H, W) float32, 0 elsewhere; a new array. numbers: others in the place of the map's own."""
        values = np.zeros(self.shape, np.float32)
        values[self.there] = (self.numbers if numbers is None else numbers).numpy()
        return values

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""
        return self._bits.nbytes + self.numbers.nbytes


class DepthMap:
    """Depth of one view at its size. Only what is known is kept.

    `DepthMap(depth, weight)`: z (H, W) in scene units, 0 unknown, and its weight (H, W), 0 ... 1, or None for 1. Where
    either isn't above 0, both are 0. shape: (H, W). Raises ValueError for 2^31 pixels or more.
    """

    def __init__(self, depth: np.ndarray, weight: np.ndarray | None):
        if depth.size > _MOST_PIXELS:
            raise ValueError(f"depth map: expected less than 2^31 pixels, found {depth.size}")
        self._depth = PositiveMap(depth if weight is None else np.where(weight > 0, depth, 0))
        self.shape = self._depth.shape
        self._weight: Tensor | None = None
        if weight is not None:
            weights = weight[self.known].astype(np.float32)
            self._weight = None if (weights == 1).all() else torch.from_numpy(weights)

    @property
    def known(self) -> np.ndarray:
        """(H, W) bool: the pixels of known depth."""
        return self._depth.there

    @property
    def depth(self) -> np.ndarray:
        """(H, W) float32 z, scene units, 0 unknown; a new array."""
        return self._depth.whole()

    @property
    def weight(self) -> np.ndarray:
        """(H, W) float32, 0 ... 1; a new array."""
        return self._depth.whole(self._weights())

    @property
    def nbytes(self) -> int:
        """Bytes that are kept."""
        return self._depth.nbytes + (0 if self._weight is None else self._weight.nbytes)

    def with_samples(self, samples: DepthSamples) -> DepthMap:
        """The map with the samples' depths, of weight 1, in their pixels."""
        depth, weight = self.depth, self.weight
        at = samples.rows.numpy(), samples.columns.numpy()
        depth[at], weight[at] = samples.depth.numpy(), 1.0
        return DepthMap(depth, weight)

    def resized(self, camera: Camera) -> DepthMap:
        """The map at the camera's size, by nearest neighbour: a mean of depths is on no surface."""
        height, width = self.shape
        if (camera.height, camera.width) == self.shape:
            return self
        rows = ((np.arange(camera.height) + 0.5) * height / camera.height).astype(np.int64)
        columns = ((np.arange(camera.width) + 0.5) * width / camera.width).astype(np.int64)
        return DepthMap(self.depth[rows[:, None], columns], self.weight[rows[:, None], columns])

    def samples(self, camera: Camera) -> DepthSamples:
        """The known depth at the pixels of the same view at the camera's size."""
        return self.resized(camera).own_samples()

    def own_samples(self) -> DepthSamples:
        """The known depth at the map's own pixels."""
        pixels = np.flatnonzero(self.known).astype(np.int32)
        rows = pixels // np.int32(self.shape[1])
        columns = pixels - rows * np.int32(self.shape[1])
        return DepthSamples(
            torch.from_numpy(rows), torch.from_numpy(columns), self._depth.numbers, self._weights(), most=1
        )

    def _weights(self) -> Tensor:
        return torch.ones_like(self._depth.numbers) if self._weight is None else self._weight
