"""Photographs as phones and cameras store them: HEIC, AVIF and raw files, by packages that need not be installed.

All come upright: HEIC and AVIF are turned as their own boxes say, not by EXIF, and raw files by their developer.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import LIGHT, USUAL, Coding, coding_of_codes, of_profile
from dofbench.core.image_files.iso_boxes import colour_codes

HEIF_SUFFIXES = (".heic", ".heif", ".hif")
AVIF_SUFFIXES = (".avif",)
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
CAMERA_SUFFIXES = (*HEIF_SUFFIXES, *AVIF_SUFFIXES, *RAW_SUFFIXES)
_INSTALL = "pip install 'dofbench[photographs]'; or the photographs as JPEG or PNG"
_RAW_LIGHT = replace(LIGHT, name="linear light developed from raw")
# OpenImageIO's names of the EXIF tags that are read here, by their number: in the first directory, in EXIF's own.
_FIRST = {0x010F: "Make", 0x0110: "Model"}
_OWN = {
    0x829A: "ExposureTime",
    0x829D: "FNumber",
    0x8827: "Exif:PhotographicSensitivity",
    0x9003: "Exif:DateTimeOriginal",
    0x9004: "Exif:DateTimeDigitized",
    0x9206: "Exif:SubjectDistance",
    0x920A: "Exif:FocalLength",
    0xA405: "Exif:FocalLengthIn35mmFilm",
    0xA434: "Exif:LensModel",
}


def is_camera_file(path: Path) -> bool:
    """Whether a file is called like one of these."""
    return path.suffix.lower() in CAMERA_SUFFIXES


def missing_package(path: Path) -> str | None:
    """The package that reads such a file and isn't installed; None where nothing is missing."""
    suffix = path.suffix.lower()
    if suffix in AVIF_SUFFIXES:
        from PIL import features

        return None if features.check("avif") else "pillow with AVIF"
    package, module = ("pillow-heif", "pillow_heif") if suffix in HEIF_SUFFIXES else ("rawpy", "rawpy")
    return None if importlib.util.find_spec(module) else package


def camera_size(path: Path) -> tuple[int, int]:
    """(width, height), upright, from the header. Raises InputError without the package, and for a damaged file."""
    return _by_suffix(path, _heif_size, _avif_size, _raw_size)


def camera_coding(path: Path) -> Coding:
    """The coding of such a file: raw files are linear light. Raises InputError for HDR, and as `camera_size`."""
    return _by_suffix(path, _heif_coding, _avif_coding, lambda path: _RAW_LIGHT)


def read_stored_camera(path: Path) -> np.ndarray:
    """Values (H, W, 3) float32 in [0, 1], upright, in the file's own coding; alpha over black.

    A raw file is developed by LibRaw to linear light with sRGB's primaries: the camera's white balance, no brightening
    (which would differ from photograph to photograph). Raises InputError as `camera_size`.
    """
    return _by_suffix(path, _read_heif, _read_avif, _read_raw)


def camera_tags(path: Path) -> dict[str, Any]:
    """EXIF tags by OpenImageIO's names; empty where there are none, or none can be read."""
    try:
        return _by_suffix(path, lambda path: _exif_tags(_heif(path).to_pillow()), _avif_tags, _raw_tags)
    except InputError:
        return {}


def _avif_tags(path: Path) -> dict[str, Any]:
    with _avif(path) as image:
        return _exif_tags(image)


def _exif_tags(image: Any) -> dict[str, Any]:
    exif = image.getexif()
    own = exif.get_ifd(0x8769)
    found = {name: exif[tag] for tag, name in _FIRST.items() if tag in exif}
    found |= {name: own[tag] for tag, name in _OWN.items() if tag in own}
    return {name: value if isinstance(value, str | int) else _number(value) for name, value in found.items()}


def _by_suffix(path: Path, heif: Callable[[Path], Any], avif: Callable[[Path], Any], raw: Callable[[Path], Any]) -> Any:
    suffix = path.suffix.lower()
    if package := missing_package(path):
        raise InputError(path, f"a {suffix[1:].upper()} file, and {package}, which reads it, isn't installed", _INSTALL)
    if not path.is_file():
        raise InputError(path, "no such file", "an image file")
    try:
        return (heif if suffix in HEIF_SUFFIXES else avif if suffix in AVIF_SUFFIXES else raw)(path)
    except InputError:
        raise
    except Exception as error:  # of damaged files the decoders raise errors of many kinds, IndexError among them
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise InputError(path, f"no readable image ({lines[0]})", "an image file") from None


def _number(value: Any) -> Any:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None


def _heif(path: Path) -> Any:
    import pillow_heif

    return pillow_heif.open_heif(path, convert_hdr_to_8bit=False)


def _heif_size(path: Path) -> tuple[int, int]:
    width, height = _heif(path).size
    return int(width), int(height)


def _heif_coding(path: Path) -> Coding:
    info = _heif(path).info
    if profile := info.get("icc_profile"):
        return of_profile(path, bytes(profile))
    codes = info.get("nclx_profile") or {}
    return coding_of_codes(path, int(codes.get("color_primaries", 2)), int(codes.get("transfer_characteristics", 2)))


def _read_heif(path: Path) -> np.ndarray:
    opened = _heif(path)
    levels = np.asarray(opened)
    # libheif's values of 10 or 12 bits come shifted to the upper end of 16.
    bits = int(opened.info.get("bit_depth", 8))
    most = 255 if levels.dtype == np.uint8 else ((1 << bits) - 1) << (16 - bits)
    return _over_black(levels.astype(np.float32) / np.float32(most), path)


def _avif(path: Path) -> Any:
    from PIL import Image

    return Image.open(path, formats=["AVIF"])


def _avif_size(path: Path) -> tuple[int, int]:
    with _avif(path) as image:
        # Pillow says how the boxes have it turned by EXIF's orientation.
        width, height = image.size
        return (height, width) if image.getexif().get(0x0112) in (5, 6, 7, 8) else (width, height)


def _avif_coding(path: Path) -> Coding:
    with _avif(path) as image:
        profile, frames = image.info.get("icc_profile"), getattr(image, "n_frames", 1)
    if frames > 1:
        raise InputError(path, f"an animation of {frames} frames", "an image of one frame")
    if profile:
        return of_profile(path, profile)
    codes = colour_codes(path)
    return USUAL if codes is None else coding_of_codes(path, *codes)


def _read_avif(path: Path) -> np.ndarray:
    from PIL import ImageOps

    with _avif(path) as image:
        levels = np.asarray(ImageOps.exif_transpose(image))
    return _over_black(levels.astype(np.float32) / np.float32(255.0), path)


def _over_black(values: np.ndarray, path: Path) -> np.ndarray:
    values = values[..., None] if values.ndim == 2 else values
    if values.shape[2] in (2, 4):
        values = values[..., :-1] * values[..., -1:]
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if values.shape[2] != 3:
        raise InputError(path, f"{values.shape[2]} channels", "1 to 4 channels")
    return np.ascontiguousarray(values)


def _raw_size(path: Path) -> tuple[int, int]:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        width, height, turned = raw.sizes.width, raw.sizes.height, raw.sizes.flip in (5, 6)
    return (height, width) if turned else (width, height)


def _raw_tags(path: Path) -> dict[str, Any]:
    """What LibRaw says of the picture; it writes 0, or no name, where it knows nothing, and 1970 for no time."""
    import rawpy

    with rawpy.imread(str(path)) as raw:
        about, lens = raw.other, raw.lens
    known = {
        "FNumber": about.aperture,
        "Exif:FocalLength": about.focal_length,
        "Exif:PhotographicSensitivity": about.iso_speed,
        "ExposureTime": about.shutter_speed,
        "Exif:DateTimeOriginal": about.timestamp.strftime("%Y:%m:%d %H:%M:%S") if about.timestamp.year > 1970 else "",
        "Exif:LensModel": lens.model,
    }
    return {name: value for name, value in known.items() if value}


def _read_raw(path: Path) -> np.ndarray:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        levels = raw.postprocess(
            use_camera_wb=True,
            no_auto_bright=True,
            gamma=(1, 1),
            output_bps=16,
            output_color=rawpy.ColorSpace.sRGB,
        )
    return np.ascontiguousarray(levels, dtype=np.float32) / np.float32(65535.0)
