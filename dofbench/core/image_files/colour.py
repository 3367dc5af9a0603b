"""From the values of an image file to sRGB: encoded in [0, 1], or linear light with its primaries."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError, first_line
from dofbench.core.image_files.coding import Coding
from dofbench.core.image_files.icc import light_of
from dofbench.core.image_files.primaries import SRGB, matrix, srgb_decode, srgb_encode

_LINEAR_SRGB = "lin_rec709_scene"


def to_srgb(values: np.ndarray, coding: Coding, file: Path) -> np.ndarray:
    """Stored values (H, W, 3) float32 in sRGB; of the usual coding bit for bit as they were.

    Encoded ones come out in [0, 1], colours outside the gamut clipped, as colour management without a perceptual table
    does; linear ones as light, not clipped. Raises InputError about `file` for a profile or primaries that can't be.
    """
    if coding.is_usual:
        return values
    try:
        light = _light(values, coding)
    except ValueError as error:
        raise InputError(file, str(error), "an image in a possible colour space") from None
    return light.astype(np.float32) if coding.linear else np.clip(srgb_encode(light), 0.0, 1.0)


def _light(values: np.ndarray, coding: Coding) -> np.ndarray:
    if coding.profile:
        return light_of(values, coding.profile)
    if coding.space:
        return _by_name(values, coding.space)
    if coding.gamma == 0:
        light = srgb_decode(values)
    elif coding.gamma == 1:
        light = values
    else:
        light = np.sign(values) * np.abs(values) ** np.float32(coding.gamma)
    if coding.chromaticities == SRGB:
        return light
    return light @ matrix(coding.chromaticities).T.astype(np.float32)


def _by_name(values: np.ndarray, space: str) -> np.ndarray:
    import OpenImageIO as oiio

    source = oiio.ImageBuf(np.ascontiguousarray(values, dtype=np.float32))
    light = oiio.ImageBufAlgo.colorconvert(source, space, _LINEAR_SRGB, colorconfig="ocio://default")
    pixels = None if light.has_error else light.get_pixels(oiio.FLOAT)
    if pixels is None:
        raise ValueError(f"colour space {space} ({first_line(light.geterror)})")
    return np.asarray(pixels, np.float32)
