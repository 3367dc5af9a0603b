"""Reading, writing and resizing images.

In memory an image is float32 (H, W, 3), RGB; encoded images are in [0, 1].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError, first_line, says_no_memory
from dofbench.core.files import refused, replacing
from dofbench.core.image_files.camera_files import camera_coding, camera_size, is_camera_file, read_stored_camera
from dofbench.core.image_files.coding import Coding, coding_of
from dofbench.core.image_files.colour import to_srgb
from dofbench.core.image_files.exr_parts import picture_part
from dofbench.core.image_files.icc import cmyk_to_srgb
from dofbench.core.image_files.iso_boxes import is_box_file
from dofbench.core.readable import check_file, check_pixels

_LARGEST_HALF = 65504.0
# deflate makes a byte out of 1032 at best (zlib's documentation); OpenEXR's other compressions have no such bound.
_DEFLATE, _DEFLATED = 1032, ("none", "rle", "zip", "zips")
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_NO_DATE = "1970:01:01 00:00:00"


def to_8bit(image: np.ndarray) -> np.ndarray:
    """Round an encoded image to the 256 levels that a PNG keeps; uint8, values outside [0, 1] saturate.

    Raises FloatingPointError for NaN, which is no level.
    """
    _check_numbers(image)
    return np.floor(np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def check_floats(subject: str, image: Any) -> None:
    """Raise InputError unless the image, an array or a tensor, holds floats: levels of 0 to 255 would be read as light
    far above white."""
    kind = str(image.dtype).removeprefix("torch.")
    if not kind.startswith(("float", "bfloat")):
        expected = "floats in [0, 1]" + (": divide by 255" if kind == "uint8" else "")
        raise InputError(subject, kind, expected)


def from_8bit(image: np.ndarray) -> np.ndarray:
    """uint8 to float32 in [0, 1]."""
    return image.astype(np.float32) / np.float32(255.0)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image file, read from its header alone.

    Raises InputError for what is no image file, and for one that claims more than 250 megapixels or 10^9 values, or
    more than its bytes can hold.
    """
    if is_camera_file(path):
        check_file(path, "an image file")
        width, height = camera_size(path)
        check_pixels(path, width, height, 4)
        return width, height
    import OpenImageIO as oiio

    check_file(path, "an image file")
    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        reason = first_line(oiio.geterror)
        if is_box_file(path):  # phones' files that were renamed
            raise InputError(path, "a HEIC or AVIF file by the name of another format", "the suffix .heic or .avif")
        raise InputError(path, f"no readable image ({reason})", "an image file")
    spec = opened.spec()
    kind = opened.format_name()
    opened.close()
    if min(spec.width, spec.height, spec.nchannels) < 1 or spec.depth > 1 or spec.deep:
        found = f"{spec.width} x {spec.height} x {spec.depth} pixels of {spec.nchannels} channels"
        raise InputError(path, found if not spec.deep else "an image of several depths a pixel", "a flat image")
    # What other programs call an EXR's image is its display window; it may have stored more of it, or less.
    shown = (spec.full_width, spec.full_height) if kind == "openexr" else (spec.width, spec.height)
    for width, height in (shown, (spec.width, spec.height)):
        check_pixels(path, width, height, spec.nchannels)
    # Whatever the file's end lacks would be found out only after memory was taken for all pixels.
    size, announced = Path(path).stat().st_size, spec.image_bytes(True)
    deflated = kind == "png" or (kind == "openexr" and spec.get_string_attribute("compression") in _DEFLATED)
    if deflated and announced > _DEFLATE * size + 2**20:
        raise InputError(path, f"{size} bytes, too few for {spec.width} x {spec.height} pixels", "a whole image file")
    return shown


def read_image(path: Path | str) -> np.ndarray:
    """Read an image as float32 (H, W, 3) in sRGB: encoded in [0, 1], or of a linear file the light, not clipped.

    Integer formats are scaled to [0, 1]; floats are kept. Other colour spaces are converted (`coding_of`); sRGB and
    what says nothing is taken bit for bit. A single channel is repeated; an alpha channel is composited over black,
    which is what it stands for in the layouts read here. Raises InputError when the file can't be read.
    """
    return read_coded(Path(path))[0]


def image_coding(path: Path) -> Coding:
    """How an image file stands for colours, from its header. Raises InputError as `coding_of`."""
    check_file(path, "an image file")
    return camera_coding(path) if is_camera_file(path) else coding_of(path)


def read_coded(path: Path) -> tuple[np.ndarray, Coding]:
    """What `read_image` reads, and how the file has it: `coding.linear` says whether it is light."""
    image_size(path)
    if is_camera_file(path):
        coding = camera_coding(path)
        return to_srgb(read_stored_camera(path), coding, path), coding
    coding = coding_of(path)
    if coding.inks:
        return _read_inks(path, coding.profile), coding
    if path.suffix.lower() == ".exr":
        part = picture_part(path)
        check_pixels(path, part.spec.width, part.spec.height, part.spec.nchannels)
        pixels = _decoded(path, part.index, within_display=True)[..., list(part.channels)]
        values = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
        return to_srgb(np.ascontiguousarray(values), coding, path), coding
    if coding.is_usual:
        return read_stored(path), coding
    return _converted(path, coding), coding


def read_stored(path: Path) -> np.ndarray:
    """The values of an image file as float32 (H, W, 3), as `read_image` but in whatever colour space they are.

    For files whose values are no colours, such as depth.
    """
    image_size(path)
    _check_whole_jpeg(path)
    pixels = _decoded(path)
    channels = pixels.shape[2]
    if channels in (2, 4):
        # OpenImageIO hands back colours already multiplied by alpha.
        pixels = pixels[..., : channels - 1]
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    if pixels.shape[2] != 3:
        raise InputError(path, f"{channels} channels", "1 to 4 channels")
    return np.ascontiguousarray(pixels)


def _decoded(path: Path, part: int = 0, *, within_display: bool = False, unassociated: bool = False) -> np.ndarray:
    """(H, W, C) float32. within_display: what an EXR's display window shows, black where it stored nothing.
    unassociated: colours that alpha hasn't been multiplied into."""
    import OpenImageIO as oiio

    config = oiio.ImageSpec()
    if unassociated:
        config.attribute("oiio:UnassociatedAlpha", 1)
    buffer = oiio.ImageBuf(str(path), part, 0, config)
    if path.suffix.lower() in _JPEG_SUFFIXES and str(buffer.nativespec().format) == "half":
        return _base_of_jpeg(path)
    window = buffer.roi_full if within_display else buffer.roi
    pixels = _pixels(buffer, window, part)
    if pixels is None:
        raise _unreadable(path, first_line(buffer.geterror), "an image file")
    pixels = np.asarray(pixels, dtype=np.float32)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _pixels(buffer: Any, window: Any, part: int = 0) -> Any:
    """The pixels of an OpenImageIO buffer in a window, as floats; None where it has an error."""
    import OpenImageIO as oiio

    # `get_pixels` decodes too, but with Python's lock held, and its cache would keep the pixels.
    buffer.read(part, 0, True)
    pixels = buffer.get_pixels(oiio.FLOAT, window) if not buffer.has_error else None
    return None if buffer.has_error else pixels


def _base_of_jpeg(path: Path) -> np.ndarray:
    """The picture for ordinary displays in a JPEG with a gain map (Ultra HDR), which OpenImageIO would apply."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            levels = np.asarray(image.convert("RGB"))
    except (OSError, ValueError) as error:
        raise InputError(path, f"no readable image ({error})", "an image file") from None
    return from_8bit(levels)


def _converted(path: Path, coding: Coding) -> np.ndarray:
    """An image in another colour space, in sRGB; over black where it has alpha."""
    pixels = _decoded(path, unassociated=True)
    if pixels.shape[2] not in (2, 4):
        return to_srgb(read_stored(path), coding, path)
    colours = pixels[..., :-1] if pixels.shape[2] == 4 else np.repeat(pixels[..., :1], 3, axis=2)
    return to_srgb(np.ascontiguousarray(colours), coding, path) * pixels[..., -1:]


def _read_inks(path: Path, profile: bytes) -> np.ndarray:
    from PIL import Image

    try:
        with Image.open(path) as image:
            levels = np.asarray(image)
    except (OSError, ValueError) as error:
        raise InputError(path, f"no readable image ({error})", "an image file") from None
    if levels.ndim != 3 or levels.shape[2] != 4:
        raise InputError(path, f"inks of shape {levels.shape}", "four inks a pixel; or an RGB image")
    try:
        return cmyk_to_srgb(levels, profile)
    except ValueError as error:
        raise InputError(path, str(error), "a profile of CMYK; or an RGB image") from None


def _unreadable(path: Path, reason: str, expected: str) -> Exception:
    """A whole image that memory doesn't suffice for is no wrong input."""
    if says_no_memory(reason):
        return MemoryError(f"{path}: {reason}")
    return InputError(path, f"no readable image ({reason})", expected)


def to_16bit(image: np.ndarray) -> np.ndarray:
    """Round an encoded image to the 65536 levels of a 16-bit PNG; uint16, values outside [0, 1] saturate.

    Raises FloatingPointError for NaN, which is no level.
    """
    _check_numbers(image)
    return np.floor(np.clip(image.astype(np.float64), 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)


def _check_numbers(image: np.ndarray) -> None:
    # Casting NaN to an integer gives black on one machine and white on another, without an error.
    if np.isnan(image).any():
        found = f"NaN in {np.isnan(image).sum()} of {image.size} values"
        raise FloatingPointError(f"image: expected numbers, found {found}")


def write_png(path: Path | str, image: np.ndarray, *, bits: int = 8) -> None:
    """Write an encoded image (H, W, 3) as PNG, atomically; the same pixels give the same bytes.

    image: floats in [0, 1]; or uint8, written as it is with 8 bits. Raises InputError for other types, and
    FloatingPointError for NaN.
    """
    path = Path(path)
    if bits != 8 or image.dtype != np.uint8:
        check_floats("image", image)
    if bits == 16:
        _write(path, to_16bit(image), "uint16", {"png:compressionLevel": 6})
        return
    pixels = image if image.dtype == np.uint8 else to_8bit(image)
    _write(path, pixels, "uint8", {"png:compressionLevel": 6})


def write_webp(path: Path, image: np.ndarray, quality: int = 85) -> None:
    """Write an encoded image (H, W, 3), floats in [0, 1], as lossy WebP, atomically; quality: 0 to 100."""
    _write(path, to_8bit(image), "uint8", {"Compression": f"webp:{quality}"})


def write_grey_png(path: Path, values: np.ndarray) -> None:
    """Write (H, W) values in [0, 1] as PNG of one channel, 8 bit, atomically; the same values give the same bytes."""
    _write(path, to_8bit(values)[..., None], "uint8", {"png:compressionLevel": 6})


def write_exr(path: Path, values: np.ndarray, *, half: bool = False) -> None:
    """Write (H, W) or (H, W, 3) float values as EXR (zip), atomically. (H, W) becomes channel Z.

    half: 11 bits a number; finite values beyond 65504, the largest of these, saturate.
    """
    names = ["Z"] if values.ndim == 2 else ["R", "G", "B"]
    pixels = (values[..., None] if values.ndim == 2 else values).astype(np.float32)
    if half:
        pixels = np.where(np.isfinite(pixels), np.clip(pixels, -_LARGEST_HALF, _LARGEST_HALF), pixels)
    _write(path, pixels, "half" if half else "float", {"compression": "zip"}, names)


def read_exr(path: Path) -> np.ndarray:
    """Read an EXR as float32: (H, W) for one channel, else (H, W, C)."""
    import OpenImageIO as oiio

    image_size(path)
    buffer = oiio.ImageBuf(str(path))
    pixels = _pixels(buffer, buffer.roi)
    if pixels is None:
        raise _unreadable(path, first_line(buffer.geterror), "an EXR file")
    pixels = np.asarray(pixels, dtype=np.float32)
    return np.ascontiguousarray(pixels[..., 0] if pixels.ndim == 3 and pixels.shape[2] == 1 else pixels)


def resize(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize (H, W[, C]) by area averaging when shrinking, bicubic when enlarging.

    What comes out stays between the least and the greatest value of each channel: an encoded image in [0, 1], and
    linear light in its own range. NaN spreads no further than its samples.
    """
    import cv2

    if image.shape[:2] == (height, width):
        return image
    shrinking = width <= image.shape[1] and height <= image.shape[0]
    method = cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC
    resized = cv2.resize(image, (width, height), interpolation=method)
    # A float32 average of whites can be 1.0000001, and a bicubic overshoots at an edge. fmin and fmax pass over NaN.
    least, greatest = np.fmin.reduce(image, axis=(0, 1)), np.fmax.reduce(image, axis=(0, 1))
    return np.clip(resized.reshape(height, width, *image.shape[2:]), least, greatest)


def cropped(image: np.ndarray, margin: int) -> np.ndarray:
    """The image (H, W[, C]) without `margin` pixels at each border."""
    height, width = image.shape[:2]
    return np.ascontiguousarray(image[margin : height - margin, margin : width - margin])


def _check_whole_jpeg(path: Path) -> None:
    """Raise InputError for a JPEG cut short: libjpeg fills what is missing with grey and says nothing."""
    if path.suffix.lower() not in _JPEG_SUFFIXES or not path.is_file():
        return
    content = path.read_bytes()
    at = 2
    # Segments up to the start of the scan; a thumbnail inside one of them has an end mark of its own.
    while content[at : at + 1] == b"\xff" and content[at + 1 : at + 2] != b"\xda":
        fill = content[at + 1 : at + 2] == b"\xff"
        at += 1 if fill else 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    if content.startswith(b"\xff\xd8") and content.find(b"\xff\xd9", at) < 0:
        raise InputError(path, f"a JPEG cut short after {len(content)} bytes", "an image file")


def _write(
    path: Path, pixels: np.ndarray, kind: str, attributes: dict[str, Any], names: list[str] | None = None
) -> None:
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names:
        spec.channelnames = tuple(names)
    for key, value in attributes.items():
        spec.attribute(key, value)
    if path.suffix.lower() == ".exr":
        # Where the image has no capDate the writer adds the time of day, and two identical runs would differ in
        # their bytes.
        spec.attribute("DateTime", _NO_DATE)
    with replacing(path) as temporary:
        output = oiio.ImageOutput.create(str(temporary))
        written = (
            output is not None
            and output.open(str(temporary), spec)
            and output.write_image(np.ascontiguousarray(pixels))
            and output.close()
        )
        # On a full disk both the PNG and the EXR writer report success.
        if not (written and _reads_back(temporary)):
            message = output.geterror if output is not None else oiio.geterror
            raise refused(path, temporary, first_line(message))


def _reads_back(path: Path) -> bool:
    """Whether all of an image file can be decoded; it takes a small part of the time that writing took."""
    import OpenImageIO as oiio

    # Not by ImageBuf, whose cache would keep the pixels.
    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        return False
    pixels = opened.read_image(opened.spec().format)
    opened.close()
    return pixels is not None and not opened.has_error
