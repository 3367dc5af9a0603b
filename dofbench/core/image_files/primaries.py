"""Colour spaces of three primaries: sRGB's curve, and matrices between primaries."""

from __future__ import annotations

import numpy as np

# x and y of red, green, blue and white.
Chromaticities = tuple[float, float, float, float, float, float, float, float]
# ITU-R BT.709-6, 1.3 and 1.4, which IEC 61966-2-1 (sRGB) takes over.
SRGB: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# SMPTE EG 432-1 with the white D65, ITU-R BT.2020-2 (table 3), Adobe RGB (1998) 4.3.1.
DISPLAY_P3: Chromaticities = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
BT_2020: Chromaticities = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ADOBE_RGB: Chromaticities = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
ADOBE_GAMMA = 563 / 256
# Bradford's cone responses (Lam 1985), by which ICC profiles adapt the white too.
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def _white(x: float, y: float) -> np.ndarray:
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def rgb_to_xyz(primaries: Chromaticities) -> np.ndarray:
    """(3, 3), from linear RGB to XYZ whose Y is 1 for white. Raises ValueError for primaries on a line."""
    xy = np.array(primaries, np.float64).reshape(4, 2)
    if not np.isfinite(xy).all() or (xy[:, 1] <= 0).any():
        raise ValueError(f"chromaticities {primaries}")
    columns = np.stack([_white(*row) for row in xy[:3]], axis=1)
    try:
        return columns * np.linalg.solve(columns, _white(*xy[3]))
    except np.linalg.LinAlgError:
        raise ValueError(f"chromaticities {primaries}") from None


def matrix(source: Chromaticities, target: Chromaticities = SRGB) -> np.ndarray:
    """(3, 3), from linear RGB to linear RGB of other primaries, the white adapted. Raises ValueError as above."""
    xyz = rgb_to_xyz(source)
    before, after = (_BRADFORD @ _white(*primaries[6:]) for primaries in (source, target))
    adapted = np.linalg.solve(_BRADFORD, (after / before)[:, None] * (_BRADFORD @ xyz))
    return np.linalg.solve(rgb_to_xyz(target), adapted)


def srgb_encode(light: np.ndarray) -> np.ndarray:
    """Linear light to sRGB's encoding (IEC 61966-2-1, 5.2), float32; negative light goes on along the line."""
    power = np.power(np.maximum(light, 0.0031308), 1 / 2.4)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * power - 0.055).astype(np.float32)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_encode`, float32."""
    power = np.power((np.maximum(encoded, 0.04045) + 0.055) / 1.055, 2.4)
    return np.where(encoded <= 0.04045, encoded / 12.92, power).astype(np.float32)


XYZ_TO_SRGB = np.linalg.inv(rgb_to_xyz(SRGB))
