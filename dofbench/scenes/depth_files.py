"""Depth maps of a scene: EXR, 16-bit PNG, npy or COLMAP's .bin to z-depth in scene units."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_exr, read_stored
from dofbench.core.readable import MOST_VALUES, read_array, read_bytes

# The disparity of anything nearer has no square in float32.
_NEAREST = 1e-18
_PNG_LEVELS = 65535


def read_depth(file: Path, unit: float) -> np.ndarray:
    """Read z-depth (H, W) float32, scene units, 0 where unknown, from EXR, 16-bit PNG, npy or COLMAP's dense stereo,
    times `unit`.

    Equal channels count as one (Blender). Infinity becomes 0, which blurs as infinitely far. Raises InputError for NaN,
    negative values, a map without a known pixel, and other files.
    """
    if file.suffix.lower() == ".exr":
        values = read_exr(file)
    elif file.suffix.lower() == ".png":
        values = _read_png(file)
    elif file.suffix.lower() == ".npy":
        values = _read_npy(file)
    elif file.suffix.lower() == ".bin":
        values = _read_colmap(file)
    else:
        raise InputError(file, f"a depth map with suffix {file.suffix or 'none'}", ".exr, 16-bit .png, .npy or .bin")
    if values.ndim == 3:
        if not np.array_equal(values, np.broadcast_to(values[..., :1], values.shape), equal_nan=True):
            raise InputError(file, f"{values.shape[2]} different channels", "one channel of depth")
        values = values[..., 0]
    # Neither NaN nor a negative number is any program's depth; which of them means unknown is for the user to say.
    for what, wrong in (("NaN", np.isnan(values)), ("negative values", values < 0)):
        if wrong.any():
            raise InputError(file, f"{what} in {wrong.sum()} of {wrong.size} pixels", "z-depth, 0 where unknown")
    depth = _scaled(values, unit, file)
    depth[np.isinf(depth)] = 0.0
    if not depth.any():
        raise InputError(file, "no pixel of known depth", "z-depth, 0 where unknown")
    return depth


def _scaled(values: np.ndarray, unit: float, file: Path) -> np.ndarray:
    """Depth in scene units, float32. Raises InputError for a unit by which a known depth is none in float32."""
    if not (math.isfinite(unit) and unit > 0):
        raise InputError(file, f"a depth unit of {unit}", "a positive number of scene units")
    known = values[np.isfinite(values) & (values > 0)]
    least, most = (float(known.min()) * unit, float(known.max()) * unit) if known.size else (1.0, 1.0)
    if most > float(np.finfo(np.float32).max) or least < _NEAREST:
        found = f"depth from {least:.3g} to {most:.3g} scene units, with a unit of {unit:g}"
        raise InputError(file, found, f"at least {_NEAREST:g}, and what float32 holds")
    return values * np.float32(unit)


def _read_npy(file: Path) -> np.ndarray:
    values = read_array(file, "an .npy file of depth")
    if values.ndim not in (2, 3) or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(file, f"{values.dtype} of shape {values.shape}", "numbers of shape (H, W)")
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinite: unknown
        return values.astype(np.float32)


def _read_colmap(file: Path) -> np.ndarray:
    """COLMAP's map: "width&height&channels&" in ASCII, then float32, little-endian, columns running fastest."""
    data = read_bytes(file, "a depth map of COLMAP", 4 * MOST_VALUES)
    parts = data[:64].split(b"&", 3)
    try:
        width, height, channels = (int(part) for part in parts[:3])
        values = np.frombuffer(data[sum(len(part) + 1 for part in parts[:3]) :], dtype="<f4")
        values = values.reshape(channels, height, width)
    except ValueError:
        raise InputError(
            file, "no depth map of COLMAP, or a part of one", "width&height&1& and as many float32"
        ) from None
    if channels != 1 or not values.size:
        raise InputError(file, f"{channels} channels", "one channel of depth")
    return values[0].astype(np.float32)


def _read_png(file: Path) -> np.ndarray:
    import OpenImageIO as oiio

    values = read_stored(file)[..., 0]
    kind = str(oiio.ImageBuf(str(file)).nativespec().format)
    if kind != "uint16":
        raise InputError(file, f"a PNG of {kind}", "16 bits a pixel, since 8 are too coarse for depth")
    # float32 holds 65535 levels with bits to spare, so rounding gives the stored integers back.
    return np.rint(values * np.float32(_PNG_LEVELS))
