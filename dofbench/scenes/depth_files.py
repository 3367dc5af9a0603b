"""Depth maps of a scene: EXR or 16-bit PNG to z-depth in scene units."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dofbench.errors import InputError
from dofbench.images import read_exr, read_image

_PNG_LEVELS = 65535


def read_depth(file: Path, unit: float) -> np.ndarray:
    """z-depth (H, W) float32, scene units, from a float EXR or an integer 16-bit PNG, times `unit`.

    Several channels are taken where they are equal (Blender writes depth so). What is not finite
    or not positive becomes 0, unknown. Raises InputError for anything else.
    """
    if file.suffix.lower() == ".exr":
        values = read_exr(file)
    elif file.suffix.lower() == ".png":
        values = _read_png(file)
    else:
        raise InputError(file, f"a depth map with suffix {file.suffix or 'none'}", ".exr or 16-bit .png")
    if values.ndim == 3:
        if not np.array_equal(values, np.broadcast_to(values[..., :1], values.shape), equal_nan=True):
            raise InputError(file, f"{values.shape[2]} different channels", "one channel of depth")
        values = values[..., 0]
    depth = values * np.float32(unit)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0.0))


def _read_png(file: Path) -> np.ndarray:
    import OpenImageIO as oiio

    values = read_image(file)[..., 0]
    kind = str(oiio.ImageBuf(str(file)).nativespec().format)
    if kind != "uint16":
        raise InputError(file, f"a PNG of {kind}", "16 bits a pixel, since 8 are too coarse for depth")
    # float32 holds 65535 levels with bits to spare, so rounding gives the stored integers back.
    return np.rint(values * np.float32(_PNG_LEVELS))
