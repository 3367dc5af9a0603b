"""Photographs in the formats of phones and cameras, for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# CIE XYZ (D65) to linear sRGB: a camera whose colours are sRGB's.
_CAMERA = [3.2404542, -1.5371385, -0.4985314, -0.9692660, 1.8760108, 0.0415560, 0.0556434, -0.2040259, 1.0572252]
_WHITE = 16383


def write_dng(file: Path, light: np.ndarray, orientation: int = 1, f_number: float = 2.8) -> None:
    """A raw file with a Bayer pattern (RGGB), 14 bits. light: (H, W, 3) linear, even sides."""
    import tifffile

    mosaic = light[..., 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = light[0::2, 0::2, 0], light[1::2, 1::2, 2]
    matrix = [number for value in _CAMERA for number in (round(value * 10000), 10000)]
    tags = [
        (274, 3, 1, orientation, True),
        (33421, 3, 2, (2, 2), True),  # a pattern of 2 x 2
        (33422, 1, 4, bytes([0, 1, 1, 2]), True),
        (33437, 5, 1, (round(f_number * 10), 10), True),
        (50706, 1, 4, bytes([1, 4, 0, 0]), True),  # DNG 1.4
        (50707, 1, 4, bytes([1, 1, 0, 0]), True),
        (50708, 2, 0, "Made Camera", True),
        (50714, 3, 1, 0, True),  # black, white
        (50717, 4, 1, _WHITE, True),
        (50721, 10, 9, matrix, True),
        (50728, 5, 3, [1, 1] * 3, True),  # neutral
        (50778, 3, 1, 21, True),  # D65
    ]
    levels = np.rint(np.clip(mosaic, 0, 1) * _WHITE).astype(np.uint16)
    tifffile.imwrite(file, levels, photometric=32803, extratags=tags)
