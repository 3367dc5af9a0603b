"""LDR-FLIP: the visible difference when flipping between two images.

Source: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: a difference evaluator for alternating
images", HPG 2020. Tests compare it with the authors' package.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from dofbench.core.similarity import checked, unmasked, valid_mean

# The authors' default: a display 3840 pixels wide, seen from as far away as it is wide.
PIXELS_PER_DEGREE = 3840 * math.pi / 180

# Contrast sensitivity in the spatial domain, for each channel of YCxCz: a and b of the terms
# a * sqrt(pi / b) * exp(-pi^2 d^2 / b) of its sum, at a distance of d degrees.
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_COLOUR_EXPONENT = 0.7  # q_c: compresses colour differences
_KNEE, _SHARE_BELOW = 0.4, 0.95  # p_c, p_t: differences up to p_c of the largest fill p_t of the range
_FEATURE_WIDTH = 0.082  # w, degrees: features of this width are detected best
_FEATURE_EXPONENT = 0.5  # q_f
_RED, _GREEN, _BLUE = (0.64, 0.33), (0.30, 0.60), (0.15, 0.06)  # sRGB's primaries, xy (ITU-R BT.709)
_WHITE = (0.31271, 0.32902)  # D65 of the CIE 1931 observer, xy


def flip(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of the LDR-FLIP error map, 0 ... 1, at 67 pixels per degree.

    prediction, truth: (H, W, 3), encoded (taken as sRGB), [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes
    that don't fit.
    """
    return valid_mean(flip_map(*unmasked(prediction, truth, mask)), mask)


def flip_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The error of each pixel, (H, W) float64; arguments as for `flip`. NaN spreads to some ten pixels around it."""
    images = [_opponent(image) for image in checked(prediction, truth)]
    difference = _colour_distance(*(_perceived(image) for image in images))
    features = [_features(image[..., 0] / 116) for image in images]
    change = np.maximum(*(np.abs(one - other) for one, other in zip(*features, strict=True)))
    return _redistributed(difference) ** (1 - (change / math.sqrt(2)) ** _FEATURE_EXPONENT)


@cache
def _to_relative_xyz() -> np.ndarray:
    """(3, 3): linear sRGB to XYZ by the white's."""
    primaries = np.array([_xyz(*xy) for xy in (_RED, _GREEN, _BLUE)]).T
    white = np.array(_xyz(*_WHITE))
    return primaries * np.linalg.solve(primaries, white) / white[:, None]


def _xyz(x: float, y: float) -> tuple[float, float, float]:
    return x / y, 1.0, (1 - x - y) / y


@cache
def _to_opponent() -> np.ndarray:
    """(3, 3): linear sRGB to YCxCz, the linear form of CIELAB (its first channel is larger by 16)."""
    return np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]]) @ _to_relative_xyz()


def _opponent(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) of the encoded image."""
    encoded = np.clip(image, 0, 1)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear @ _to_opponent().T


def _filtered(channel: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """A channel (H, W) filtered by two kernels, the border replicated."""
    import cv2

    return cv2.sepFilter2D(np.ascontiguousarray(channel), -1, across, down, borderType=cv2.BORDER_REPLICATE)


def _perceived(opponent: np.ndarray) -> np.ndarray:
    """(H, W, 3) in CIELAB with Hunt's adjustment, filtered by the eye's contrast sensitivity."""
    # One radius for all channels: three standard deviations of the widest Gaussian.
    widest = max(b for terms in _SENSITIVITY for _, b in terms)
    radius = math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * PIXELS_PER_DEGREE)
    degrees = np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
    seen = np.empty_like(opponent)
    for channel, terms in enumerate(_SENSITIVITY):
        amplitudes = [a * math.sqrt(math.pi / b) for a, b in terms]
        kernels = [np.exp(-((math.pi * degrees) ** 2) / b) for _, b in terms]
        total = sum(a * kernel.sum() ** 2 for a, kernel in zip(amplitudes, kernels, strict=True))
        seen[..., channel] = sum(
            a / total * _filtered(opponent[..., channel], kernel, kernel)
            for a, kernel in zip(amplitudes, kernels, strict=True)
        )
    return _hunt_lab(np.clip(seen @ np.linalg.inv(_to_opponent()).T, 0, 1))


def _hunt_lab(linear: np.ndarray) -> np.ndarray:
    """(..., 3) CIELAB of linear sRGB, a and b scaled by L / 100 (Hunt effect)."""
    relative = linear @ _to_relative_xyz().T
    bend = 6 / 29
    root = np.where(relative > bend**3, np.cbrt(relative), relative / (3 * bend**2) + 4 / 29)
    lightness = 116 * root[..., 1] - 16
    a, b = 500 * (root[..., 0] - root[..., 1]), 200 * (root[..., 1] - root[..., 2])
    return np.stack([lightness, lightness / 100 * a, lightness / 100 * b], axis=-1)


def _colour_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(...) HyAB: the distance in lightness plus that in the plane of colours."""
    difference = one - other
    return np.abs(difference[..., 0]) + np.hypot(difference[..., 1], difference[..., 2])


@cache
def _largest_difference() -> float:
    """Compressed distance of sRGB's green and blue, the largest of all."""
    green, blue = _hunt_lab(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    return float(_colour_distance(green, blue)) ** _COLOUR_EXPONENT


def _redistributed(difference: np.ndarray) -> np.ndarray:
    """Colour differences in [0, 1]: compressed, with most of the range for small ones."""
    largest = _largest_difference()
    knee = _KNEE * largest
    compressed = difference**_COLOUR_EXPONENT
    above = _SHARE_BELOW + (compressed - knee) / (largest - knee) * (1 - _SHARE_BELOW)
    return np.where(compressed < knee, _SHARE_BELOW / knee * compressed, above)


def _features(lightness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) strengths of edges and of points, by the first and second derivatives of a Gaussian."""
    deviation = _FEATURE_WIDTH / 2 * PIXELS_PER_DEGREE
    x = np.arange(-math.ceil(3 * deviation), math.ceil(3 * deviation) + 1.0)
    smooth = np.exp(-(x**2) / (2 * deviation**2))
    edge, point = (_balanced(kernel * smooth) for kernel in (x, x**2 / deviation**2 - 1))
    smooth /= smooth.sum()
    edges, points = (
        np.hypot(_filtered(lightness, kernel, smooth), _filtered(lightness, smooth, kernel)) for kernel in (edge, point)
    )
    return edges, points


def _balanced(kernel: np.ndarray) -> np.ndarray:
    """The kernel with positive weights of sum 1 and negative ones of sum -1."""
    positive, negative = kernel.clip(min=0), kernel.clip(max=0)
    return positive / positive.sum() - negative / negative.sum()
