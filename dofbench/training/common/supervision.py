"""Known depth of a view for depth supervision (section 4.2): at the structure-from-motion points, or as a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.scenes.visibility import visible


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """rows, columns: (M,) int64 pixels; depth: (M,) float32 z in scene units. weight: (M,), or None for equal
    weights. most: how many lie in one pixel, at most, where they are in the order of rows, then columns, else None."""

    rows: Tensor
    columns: Tensor
    depth: Tensor
    weight: Tensor | None = None
    most: int | None = None

    def within(self, mask: Tensor) -> DepthSamples:
        """The samples at pixels where mask (H, W) is true, on the host."""
        kept = mask[self.rows, self.columns]
        weight = None if self.weight is None else self.weight[kept]
        return DepthSamples(self.rows[kept], self.columns[kept], self.depth[kept], weight)

    def on(self, device: str) -> DepthSamples:
        """The samples on a device, in the order of rows, then columns."""
        rows_first = self.rows.numpy(force=True) << 32 | self.columns.numpy(force=True)
        order = torch.from_numpy(np.argsort(rows_first, kind="stable")).to(self.rows.device)
        _, many = np.unique(rows_first, return_counts=True)
        tensors = (self.rows, self.columns, self.depth, self.weight)
        rows, columns, depth, weight = (None if one is None else one[order].to(device) for one in tensors)
        assert rows is not None and columns is not None and depth is not None
        return DepthSamples(rows, columns, depth, weight, int(many.max(initial=1)))


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of one view at its size: z (H, W) float32 in scene units, 0 unknown, and its weight (H, W), 0 ... 1."""

    depth: np.ndarray
    weight: np.ndarray

    def with_samples(self, samples: DepthSamples) -> DepthMap:
        """The map with the samples' depths, of weight 1, in the samples' pixels."""
        depth, weight = self.depth.copy(), self.weight.copy()
        at = samples.rows.numpy(), samples.columns.numpy()
        depth[at], weight[at] = samples.depth.numpy(), 1.0
        return DepthMap(depth, weight)

    def samples(self, camera: Camera) -> DepthSamples:
        """The known depth at the pixels of the same view at the camera's size.

        Resampled by nearest neighbour, because a mean of depths, or of depths and zeros, lies on no surface.
        """
        height, width = self.depth.shape
        rows = ((np.arange(camera.height) + 0.5) * height / camera.height).astype(np.int64)
        columns = ((np.arange(camera.width) + 0.5) * width / camera.width).astype(np.int64)
        depth, weight = (values[rows[:, None], columns] for values in (self.depth, self.weight))
        known = np.nonzero((depth > 0) & (weight > 0))
        return DepthSamples(
            rows=torch.from_numpy(known[0]),
            columns=torch.from_numpy(known[1]),
            depth=torch.from_numpy(depth[known].astype(np.float32)),
            weight=torch.from_numpy(weight[known].astype(np.float32)),
        )


def sparse_depth(points: PointCloud, camera: Camera, view: int) -> DepthSamples:
    """Depth of the points that view number `view` sees (`scenes/visibility.py`), at the pixels that they project to."""
    seen = visible(points, camera, view)
    pixels = seen.xy.astype(np.int64)
    return DepthSamples(
        rows=torch.from_numpy(pixels[:, 1].copy()),
        columns=torch.from_numpy(pixels[:, 0].copy()),
        depth=torch.from_numpy(seen.depth.astype(np.float32)),
    )


def all_disparities(points: PointCloud, cameras: Sequence[Camera]) -> np.ndarray:
    """Disparities, 1 / scene unit, of all points over all views that see them."""
    found = [1.0 / sparse_depth(points, camera, index).depth.numpy() for index, camera in enumerate(cameras)]
    return np.concatenate(found)
