"""Lens blur that knows what hides what: depth layers, each scattered by itself, composited back to front.

The plain scatter adds up every pixel's light wherever it lands, so a blurred background shines through a focused
foreground and nothing is known behind a blurred one. Here pixels are cut into layers by their signed radius. A layer
goes on behind the nearer ones, with the colour and radius of its nearest visible pixel, so that something is there
where a blurred foreground becomes transparent; and of the layers that could go on behind a place the one that
shows nearest to it does. The light and the opacity of a layer are scattered alike and laid over what is behind
(the "over" of Porter and Duff, 1984). Within a layer the result is the plain scatter's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from dofbench.lens import LAYERS


def layered_blur(
    linear: Tensor, signed_radius: Tensor, scatter: Callable[[Tensor, Tensor], Tensor], *, layers: int = LAYERS
) -> Tensor:
    """Blur `linear`, (H, W, 3) linear light, by `signed_radius`, (H, W) pixels, positive nearer; (H, W, 3).

    scatter: blurs an (H, W, C) image by an (H, W) radius, normalised so that a constant stays one. layers: into which
    the range of radii is cut evenly. No gradient. Raises ValueError for less than one layer, and what `scatter` does
    for a radius that isn't finite.
    """
    if layers < 1:
        raise ValueError(f"layers: expected at least 1, found {layers}")
    radius = signed_radius.numpy()
    least, most = float(radius.min()), float(radius.max())
    if layers == 1 or not 0 < most - least < math.inf:  # the scatter raises for a radius that isn't finite
        return scatter(linear, signed_radius)
    label = np.minimum((radius - least) / (most - least) * layers, layers - 1).astype(np.int32)
    flat_colour, flat_radius, flat_label = linear.reshape(-1, 3).numpy(), radius.reshape(-1), label.reshape(-1)
    behind = torch.zeros_like(linear)
    for index in np.unique(label):
        visible = _nearest(label <= index)
        member = flat_label[visible] == index
        colour = np.where(member[..., None], flat_colour[visible], 0)
        # Where the layer isn't, empty space is spread as wide as the layer beside it: opacity is then the
        # share of the circle of confusion that the layer covers.
        own = flat_radius[visible] if member.all() else flat_radius[visible].reshape(-1)[_nearest(member)]
        light = np.concatenate([colour, member[..., None]], axis=2).astype(linear.numpy().dtype, copy=False)
        over = scatter(torch.from_numpy(light), torch.from_numpy(np.ascontiguousarray(own)))
        behind = over[..., :3] + (1 - over[..., 3:]) * behind
    return behind


def _nearest(chosen: np.ndarray) -> np.ndarray:
    """(H, W) flat index of the chosen pixel that is nearest to each pixel; itself where it is chosen."""
    import cv2

    places = np.flatnonzero(chosen)
    if places.size == chosen.size:
        return places.reshape(chosen.shape)
    _, labels = cv2.distanceTransformWithLabels(
        np.logical_not(chosen).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    # OpenCV numbers the chosen pixels in an order of its own.
    of_label = np.zeros(labels.max() + 1, dtype=np.int64)
    of_label[labels.reshape(-1)[places]] = places
    return of_label[labels]
