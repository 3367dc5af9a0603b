"""Which surfaces the training views resolve.

A surface with a large CoC radius in every training view can be explained by many sharp scenes; an all-in-focus
rendering shows just one of them. So for every pixel the smallest CoC radius of its surface in any training view is
computed, by the method's own depth and learned lenses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method
from dofbench.core.lens import PhysicalLens

RESOLVED_COLUMN = "resolved"
RESOLVED = 1.0  # px, CoC radius up to which no detail is lost
SAME_SURFACE = 0.03  # relative difference of z up to which two views see one surface
FULL_SCALE = 10.0  # px, CoC radius with the darkest colour
COLOURS = "viridis"


class ResolvedCircles:
    """CoC radii in the training views of the surfaces seen by a camera. photographs: camera and learned lens of
    each. seen: the same with the rendered depth, (H, W)."""

    def __init__(self, method: Method, photographs: Sequence[tuple[Camera, PhysicalLens]]):
        self._method = method
        self.seen = [(camera, lens, np.asarray(method.render(camera, None).depth)) for camera, lens in photographs]

    def smallest(self, camera: Camera) -> np.ndarray:
        """(H, W), px of the training views: the smallest CoC radius of the pixel's surface in any of them; infinite if
        none sees it, NaN without a surface."""
        depth = np.asarray(self._method.render(camera, None).depth, np.float64)
        there = np.isfinite(depth) & (depth > 0)
        z = np.where(there, depth, 1.0)
        x, y = camera.rays(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        local = np.stack([x * z, y[:, None] * z, z, np.ones_like(z)], axis=-1)
        world = (local.reshape(-1, 4) @ camera.camera_to_world.T)[:, :3]
        smallest = np.full(len(world), math.inf)
        for other, lens, surface in self.seen:
            xy, distance = other.project(world)
            inside = other.inside(xy)
            column, row = np.where(inside[:, None], xy, 0).astype(np.int64).T
            with np.errstate(divide="ignore", invalid="ignore"):
                same = inside & (np.abs(surface[row, column] / distance - 1) < SAME_SURFACE)
                circle = np.abs(lens.signed_radius(1 / distance, other.width))
            smallest = np.where(same, np.minimum(smallest, circle), smallest)
        return np.where(there, smallest.reshape(depth.shape), np.nan)


def resolved_share(circles: np.ndarray) -> float:
    """Per cent of the pixels with a surface whose radius is at most `RESOLVED`; NaN without any surface."""
    there = ~np.isnan(circles)
    return 100 * float((circles[there] <= RESOLVED).mean()) if there.any() else math.nan


def resolved_map(circles: np.ndarray) -> np.ndarray:
    """uint8 (H, W, 3): light where the surface is resolved, dark where it isn't, black without a surface."""
    from matplotlib import colormaps

    shade = 1 - np.clip(np.nan_to_num(circles, nan=FULL_SCALE, posinf=FULL_SCALE) / FULL_SCALE, 0, 1)
    picture = colormaps[COLOURS](shade, bytes=True)[..., :3].copy()
    picture[np.isnan(circles)] = 0
    return picture


def photographs_of(
    cameras: Mapping[str, Camera], lenses: Mapping[str, PhysicalLens]
) -> list[tuple[Camera, PhysicalLens]]:
    """Each training view's camera and learned lens, by name."""
    return [(camera, lenses[name]) for name, camera in cameras.items() if name in lenses]
