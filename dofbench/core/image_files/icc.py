"""ICC profiles: from the values of a device to linear light with sRGB's primaries.

Profiles of three curves and a matrix go through OpenColorIO, in float32. Those of tables, of grey and of inks go
through littleCMS, whose 8 bits are all that Pillow offers.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import io
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dofbench.core.errors import first_line
from dofbench.core.image_files.primaries import XYZ_TO_SRGB, srgb_decode, srgb_encode

# What a profile is: sRGB itself, so that nothing is converted; proportional to light; or encoded in another way.
Kind = Literal["sRGB", "linear", "encoded"]
# One level of 8 bits: the sRGB profiles in use differ from each other by half of one.
_SAME = 1.0 / 255.0
_PROBES = 9
_LEVELS = 256
_MATRIX_TAGS = {b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"}


@functools.lru_cache(maxsize=64)
def profile_kind(profile: bytes) -> Kind:
    """What an image's profile makes of its values. Raises ValueError as `light_of`."""
    ends = np.linspace(0.0, 1.0, _PROBES, dtype=np.float32)
    grid = np.stack(np.meshgrid(ends, ends, ends, indexing="ij"), axis=-1).reshape(_PROBES, -1, 3)
    light = light_of(grid, profile)
    # Inside the gamut alone: littleCMS clips what OpenColorIO doesn't.
    if np.abs(np.clip(srgb_encode(light), 0, 1) - grid).max() <= _SAME:
        return "sRGB"
    grey = light_of(np.repeat(ends[None, :, None], 3, axis=2), profile)[0]
    return "linear" if np.abs(grey - ends[:, None]).max() <= _SAME else "encoded"


def light_of(values: np.ndarray, profile: bytes) -> np.ndarray:
    """Values (H, W, 3) in [0, 1], as the device of the profile has them, to linear light, sRGB's primaries.

    float32, beyond [0, 1] for colours that sRGB lacks. A profile of grey takes the first channel. Raises ValueError
    for a profile that is damaged, or of another kind of device.
    """
    space = profile[16:20]
    if space == b"GRAY":
        return _grey(values, profile)
    if space != b"RGB ":
        name = space.decode("ascii", "replace").strip() or "no colour space"
        raise ValueError(f"an ICC profile of {name} in an RGB image")
    tags = _tags(profile)
    if tags >= _MATRIX_TAGS and b"A2B0" not in tags:
        return _by_matrix(values, profile)
    return srgb_decode(_by_tables(values, "RGB", profile))


def cmyk_to_srgb(levels: np.ndarray, profile: bytes) -> np.ndarray:
    """Inks (H, W, 4), uint8, to encoded sRGB: (H, W, 3) float32. Raises ValueError as `light_of`."""
    return _transformed(levels, "CMYK", profile)


def profile_name(profile: bytes) -> str:
    """What a profile calls itself, such as "Display P3"."""
    from PIL import ImageCms

    try:
        name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))
    except (OSError, ImageCms.PyCMSError):
        return "an ICC profile"
    return " ".join(name.split()) or "an ICC profile"


def _tags(profile: bytes) -> set[bytes]:
    # ICC.1:2022, 7.3: a count after the header of 128 bytes, then 12 bytes a tag, which begin with its name.
    count = min(int.from_bytes(profile[128:132], "big"), len(profile) // 12)
    return {profile[132 + 12 * index : 136 + 12 * index] for index in range(count)}


def _by_matrix(values: np.ndarray, profile: bytes) -> np.ndarray:
    import OpenImageIO as oiio

    # OpenImageIO knows its files by name, and keeps what it read of them: a name for every content.
    path = _folder() / f"{hashlib.sha256(profile).hexdigest()}.icc"
    if not path.is_file():
        path.write_bytes(profile)
    # The transform of a monitor's profile leads from XYZ (D65) to the device.
    source = oiio.ImageBuf(np.ascontiguousarray(values, dtype=np.float32))
    xyz = oiio.ImageBufAlgo.ociofiletransform(source, str(path), inverse=True)
    pixels = None if xyz.has_error else xyz.get_pixels(oiio.FLOAT)
    if pixels is None:
        raise ValueError(f"no readable ICC profile ({first_line(xyz.geterror)})")
    return np.asarray(pixels, np.float32) @ XYZ_TO_SRGB.T.astype(np.float32)


@functools.cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="dofbench-icc-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _grey(values: np.ndarray, profile: bytes) -> np.ndarray:
    levels = np.arange(_LEVELS, dtype=np.uint8)[None]
    curve = _transformed(levels, "L", profile)[0, :, 0]
    encoded = np.interp(values[..., 0], np.linspace(0.0, 1.0, _LEVELS), curve).astype(np.float32)
    return srgb_decode(np.repeat(encoded[..., None], 3, axis=2))


def _by_tables(values: np.ndarray, mode: str, profile: bytes) -> np.ndarray:
    levels = np.floor(np.clip(values, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    return _transformed(levels, mode, profile)


def _transformed(levels: np.ndarray, mode: str, profile: bytes) -> np.ndarray:
    """By littleCMS, perceptual: uint8 to encoded sRGB, (H, W, 3) float32."""
    from PIL import Image

    converted = _transform(profile, mode)(Image.fromarray(np.ascontiguousarray(levels), mode))
    return np.asarray(converted.convert("RGB"), np.float32) / np.float32(255.0)


@functools.lru_cache(maxsize=16)
def _transform(profile: bytes, mode: str) -> Callable[[Any], Any]:
    from PIL import ImageCms

    try:
        source, target = ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
        transform = ImageCms.buildTransform(source, target, mode, "RGB")
    except (OSError, ImageCms.PyCMSError) as error:
        raise ValueError(f"no ICC profile of {mode} that littleCMS can read ({error})") from None
    return functools.partial(ImageCms.applyTransform, transform=transform)
