"""Separates pixels on outlines into the colours of the near and the far surface.

Such a pixel mixes two colours but has one depth; blurred as a whole it would leave a seam. Its share of the near
surface is estimated from the colours on either side by least squares of C = a F + (1 - a) B (Porter and Duff, 1984);
then the two colours are adjusted so that their mixture is exactly the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dofbench.optics.depth_edges import JUMP

_REACH = 2  # pixels: distance at which the colours of the two surfaces are sampled
_WHITE = 1.0  # colours are clipped at white, so that highlights next to an outline don't distort the estimate
_UNEXPLAINED = 0.25  # share of the colours' difference: a pixel farther from their mixtures is kept
_PURE = 0.1  # a pixel with a smaller share of one surface is of the other surface
_DISTINCT = 1e-3  # squared difference in linear light below which colours aren't separated


@dataclass(frozen=True, eq=False)
class MixedPixels:
    """rows, columns: (N,). share: (N,) of the nearer surface, 0 ... 1. near, far: (N, 3) colours, linear light.

    near_radius, far_radius: (N,) signed radii, pixels.
    """

    rows: np.ndarray
    columns: np.ndarray
    share: np.ndarray
    near: np.ndarray
    far: np.ndarray
    near_radius: np.ndarray
    far_radius: np.ndarray

    def where(self, chosen: np.ndarray) -> MixedPixels:
        """The chosen pixels."""
        return MixedPixels(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def mixed_pixels(linear: np.ndarray, signed_radius: np.ndarray) -> MixedPixels:
    """The pixels next to a jump of the signed radius, (H, W) pixels, that mix the surfaces on both sides.

    linear: (H, W, 3), linear light. Pixels between two jumps, such as a wire one pixel wide, are excluded.
    """
    import cv2

    around = np.ones((3, 3), np.uint8)
    radius = signed_radius.astype(np.float32)
    behind = cv2.dilate(radius, around) - radius > JUMP
    before = radius - cv2.erode(radius, around) > JUMP
    pure = ~(behind | before)
    rows, columns = np.nonzero(behind ^ before)
    is_behind, own = behind[rows, columns], radius[rows, columns]
    near, far = _Side(len(rows)), _Side(len(rows))
    for dy in range(-_REACH, _REACH + 1):
        for dx in range(-_REACH, _REACH + 1):
            if dy == dx == 0:
                continue
            y = np.clip(rows + dy, 0, radius.shape[0] - 1)
            x = np.clip(columns + dx, 0, radius.shape[1] - 1)
            other = radius[y, x]
            weight = pure[y, x] / np.float32(dy * dy + dx * dx)
            same = np.abs(other - own) <= JUMP
            colour = np.minimum(linear[y, x], _WHITE)
            near.add(weight * np.where(is_behind, other - own > JUMP, same), colour, other)
            far.add(weight * np.where(is_behind, same, own - other > JUMP), colour, other)
    both = (near.weight > 0) & (far.weight > 0)
    rows, columns = rows[both], columns[both]
    (front, front_radius), (back, back_radius) = near.mean(both), far.mean(both)
    colour, difference = linear[rows, columns], front - back
    length = (difference**2).sum(axis=1)
    share = ((colour - back) * difference).sum(axis=1) / np.maximum(length, _DISTINCT)
    left = ((colour - back - share[:, None] * difference) ** 2).sum(axis=1)
    explained = (left <= _UNEXPLAINED**2 * length) & (length >= _DISTINCT) & (share > _PURE) & (share < 1 - _PURE)
    found = MixedPixels(rows, columns, share, front, back, front_radius, back_radius).where(explained)
    colour, share, front, back = colour[explained], found.share[:, None], found.near, found.far
    # The smallest change of both colours after which their mixture is exactly the pixel.
    left_over = (colour - share * front - (1 - share) * back) / (share**2 + (1 - share) ** 2)
    front, back = np.maximum(front + share * left_over, 0), np.maximum(back + (1 - share) * left_over, 0)
    return replace(found, near=front, far=back)


class _Side:
    """Weighted means of the pure pixels on one side."""

    def __init__(self, count: int):
        self.weight = np.zeros(count, np.float32)
        self._colour, self._radius = np.zeros((count, 3)), np.zeros(count)

    def add(self, weight: np.ndarray, colour: np.ndarray, radius: np.ndarray) -> None:
        self.weight += weight
        self._colour += weight[:, None] * colour
        self._radius += weight * radius

    def mean(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weight = self.weight[chosen]
        return self._colour[chosen] / weight[:, None], self._radius[chosen] / weight
