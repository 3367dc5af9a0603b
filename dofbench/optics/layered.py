"""Defocus with occlusion: depth layers, each scattered separately, composited back to front.

The plain scatter sums the light of all pixels: a blurred background leaks into a focused foreground, and nothing is
visible behind a blurred foreground. Here, within one CoC radius of every depth edge, pixels are divided into layers by
signed radius. A layer is continued behind nearer layers, with the radius of its nearest visible pixels and smoothly
continued colours. A pixel on an outline belongs to two layers (`mixed_pixels.py`). Light and opacity of a layer are
scattered alike and composited ("over" of Porter and Duff, 1984). Away from depth edges the result is the plain
scatter's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import LAYERS
from dofbench.optics.depth_edges import near_depth_edges
from dofbench.optics.mixed_pixels import MixedPixels, mixed_pixels

_COARSE_RADIUS = 6.0  # least radius, pixels of the reduced resolution, of a layer that is blurred at one
_MOST_HALVINGS = 4
_MARGIN = 8  # pixels around what a layer can reach
_SEAM = 2  # pixels around the region of the depth edges over which the two results are blended


def layered_blur(
    linear: Tensor,
    signed_radius: Tensor,
    scatter: Callable[[Tensor, Tensor], Tensor],
    *,
    layers: int = LAYERS,
    coarse: bool = False,
) -> Tensor:
    """Blur `linear`, (H, W, 3) linear light, by `signed_radius`, (H, W) pixels, positive nearer; (H, W, 3).

    scatter: blurs an (H, W, C) image by an (H, W) radius and keeps constant images. layers: equal intervals of the
    range of radii. coarse: blur a layer whose radii are large at a half, a quarter or less of the resolution, for large
    images. Not differentiable. Raises ValueError for less than one layer, and the errors of `scatter`.
    """
    if layers < 1:
        raise ValueError(f"layers: expected at least 1, found {layers}")
    if coarse and layers > 1 and bool(signed_radius.max() > signed_radius.min()):
        return _composited(linear.numpy(), signed_radius.numpy(), scatter, layers, coarse=True)
    plain = scatter(linear, signed_radius)  # raises for a radius that isn't finite
    radius = signed_radius.numpy()
    edges = near_depth_edges(radius) if layers > 1 else np.zeros(radius.shape, dtype=bool)
    if not edges.any():
        return plain
    share = torch.from_numpy(_softened(edges).astype(linear.numpy().dtype))[..., None]
    return share * _composited(linear.numpy(), radius, scatter, layers) + (1 - share) * plain


def _composited(
    linear: np.ndarray,
    radius: np.ndarray,
    scatter: Callable[[Tensor, Tensor], Tensor],
    layers: int,
    *,
    coarse: bool = False,
) -> Tensor:
    least, most = float(radius.min()), float(radius.max())

    def layer_of(some: np.ndarray) -> np.ndarray:
        return np.clip((some - least) / (most - least) * layers, 0, layers - 1).astype(np.int32)

    mixed = mixed_pixels(linear, radius)
    near_layer, far_layer = layer_of(mixed.near_radius), layer_of(mixed.far_radius)
    mixed, near_layer = mixed.where(near_layer != far_layer), near_layer[near_layer != far_layer]
    # A mixed pixel is its far surface, partly covered by the near one.
    linear, radius = linear.copy(), radius.copy()
    linear[mixed.rows, mixed.columns], radius[mixed.rows, mixed.columns] = mixed.far, mixed.far_radius
    label = layer_of(radius)
    behind = torch.from_numpy(np.zeros_like(linear))
    for index in np.union1d(label, near_layer):
        before = mixed.where(near_layer == index)
        if not coarse:
            light, own = _layer(linear, radius, label, index, before)
            over = scatter(torch.from_numpy(light), torch.from_numpy(own))
            behind = over[..., :3] + (1 - over[..., 3:]) * behind
            continue
        window = _window(label == index, before, 2 * max(-least, most) + _MARGIN)
        parts = linear[window], radius[window], label[window]
        factor = _reduction(parts[1][parts[2] == index])
        if factor > 1:
            over = _scattered_coarsely(*parts, index, scatter, factor)
        else:
            rows, columns = before.rows - window[0].start, before.columns - window[1].start
            light, own = _layer(*parts, index, replace(before, rows=rows, columns=columns))
            over = scatter(torch.from_numpy(light), torch.from_numpy(own))
        behind[window] = over[..., :3] + (1 - over[..., 3:]) * behind[window]
    return behind


def _window(chosen: np.ndarray, before: MixedPixels, reach: float) -> tuple[slice, slice]:
    """The rows and columns of a layer's pixels and those it covers in part, and of all within `reach` pixels.

    Farther away the layer is hidden: a nearer one in front of it is opaque one radius from its outline.
    """
    found = []
    for axis, partly in ((1, before.rows), (0, before.columns)):
        places = np.concatenate([np.flatnonzero(chosen.any(axis=axis)), partly])
        start, stop = int(places.min() - reach), int(places.max() + reach) + 1
        found.append(slice(max(0, start), min(chosen.shape[1 - axis], stop)))
    return found[0], found[1]


def _reduction(radius: np.ndarray) -> int:
    """By how much the resolution of a layer with these radii may be reduced: a power of two."""
    least = float(np.abs(radius).min()) if radius.size else 0.0
    return 1 << int(np.clip(np.floor(np.log2(max(least, 1.0) / _COARSE_RADIUS)), 0, _MOST_HALVINGS))


def _scattered_coarsely(
    linear: np.ndarray,
    radius: np.ndarray,
    label: np.ndarray,
    index: int,
    scatter: Callable[[Tensor, Tensor], Tensor],
    factor: int,
) -> Tensor:
    """Scattered light and opacity of one layer, (H, W, 4), computed at 1 / `factor` of the resolution.

    Cells are averages over the layer's own pixels, so that no colour of another layer enters.
    """
    import cv2

    height, width = radius.shape
    padding = ((0, -height % factor), (0, -width % factor))
    labels = np.pad(label, padding, mode="edge")[factor // 2 :: factor, factor // 2 :: factor]
    size = labels.shape[::-1]
    mine = np.pad(label == index, padding, mode="edge").astype(np.float32)
    weight = cv2.resize(mine, size, interpolation=cv2.INTER_AREA)
    known = weight > 0

    def cells(values: np.ndarray) -> np.ndarray:
        """Means over the layer's pixels, where there are some; elsewhere what lies in the middle."""
        full = np.pad(values, (*padding, *[(0, 0)] * (values.ndim - 2)), mode="edge").astype(np.float32)
        own = mine if values.ndim == 2 else mine[..., None]
        total = cv2.resize(full * own, size, interpolation=cv2.INTER_AREA)
        middle = full[factor // 2 :: factor, factor // 2 :: factor]
        wide = known if values.ndim == 2 else known[..., None]
        part = np.maximum(weight if values.ndim == 2 else weight[..., None], 1e-6)
        return np.where(wide, total / part, middle)

    small_radius = (cells(radius) / factor).astype(radius.dtype)
    light, own = _layer(cells(linear).astype(linear.dtype), small_radius, labels, index, None)
    over = scatter(torch.from_numpy(light), torch.from_numpy(own)).numpy()
    enlarged = cv2.resize(over, (size[0] * factor, size[1] * factor), interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(np.ascontiguousarray(enlarged[:height, :width]))


def _layer(
    linear: np.ndarray, radius: np.ndarray, label: np.ndarray, index: int, before: MixedPixels | None
) -> tuple[np.ndarray, np.ndarray]:
    """Light and opacity of one layer, (H, W, 4), and their radius, (H, W). before: pixels that it covers in part."""
    seen = label <= index
    nearest = _nearest(seen)
    member = label.reshape(-1)[nearest] == index
    colour = np.where(seen[..., None], linear, _continued(linear, label == index)) if not seen.all() else linear
    light = np.concatenate([colour, np.ones_like(colour[..., :1])], axis=2) * member[..., None]
    own = radius.reshape(-1)[nearest]
    if before is not None:
        light[before.rows, before.columns, :3] = before.near * before.share[:, None]
        light[before.rows, before.columns, 3] = before.share
        own[before.rows, before.columns] = before.near_radius
        member[before.rows, before.columns] = True
    if not member.all():
        # Pixels outside the layer are transparent, with the radius of its nearest pixel: the scattered opacity is the
        # share of the CoC that the layer covers.
        own = own.reshape(-1)[_nearest(member)]
    return light.astype(linear.dtype, copy=False), np.ascontiguousarray(own)


def _continued(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The image with unknown pixels filled smoothly (pull-push: Gortler et al., The Lumigraph, 1996)."""
    import cv2

    if known.all() or not known.any():
        return image
    height, width = known.shape
    half = ((width + 1) // 2, (height + 1) // 2)
    padding = ((0, height % 2), (0, width % 2))
    weight = known.astype(np.float32)
    coarse_weight = cv2.resize(np.pad(weight, padding), half, interpolation=cv2.INTER_AREA)
    weighted = np.pad((image * weight[..., None]).astype(np.float32), (*padding, (0, 0)))
    coarse = cv2.resize(weighted, half, interpolation=cv2.INTER_AREA) / np.maximum(coarse_weight, 1e-6)[..., None]
    filled = _continued(coarse, coarse_weight > 0)
    fine = cv2.resize(filled, (2 * half[0], 2 * half[1]), interpolation=cv2.INTER_LINEAR)
    return np.where(known[..., None], image, fine[:height, :width])


def _softened(mask: np.ndarray) -> np.ndarray:
    """(H, W) weight: 1 on the mask, falling to 0 over a few pixels around it."""
    import cv2

    distance = cv2.distanceTransform(np.logical_not(mask).astype(np.uint8), cv2.DIST_L2, 5)
    return np.clip(1 - distance / (_SEAM + 1), 0, 1)


def _nearest(chosen: np.ndarray) -> np.ndarray:
    """(H, W) flat index of the nearest chosen pixel."""
    import cv2

    places = np.flatnonzero(chosen)
    if places.size == chosen.size:
        return places.reshape(chosen.shape)
    _, labels = cv2.distanceTransformWithLabels(
        np.logical_not(chosen).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    # OpenCV labels the chosen pixels in an unspecified order.
    of_label = np.zeros(labels.max() + 1, dtype=np.int64)
    of_label[labels.reshape(-1)[places]] = places
    return of_label[labels]
