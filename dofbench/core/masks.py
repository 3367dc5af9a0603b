"""Masks: the pixels of an image that count. True is a pixel to use; False is masked, neither trained on nor scored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError, first_line
from dofbench.core.images import write_grey_png

# Of 255: a JPEG's black isn't quite black. In every other format whatever isn't 0 counts, as in COLMAP and nerfstudio.
_JPEG_VALID = 128
# Least alpha of an opaque pixel: half a level of 16 bits below 1.
_OPAQUE = 1 - 0.5 / 65535


@dataclass(frozen=True, eq=False)
class PackedMask:
    """A mask of one bit a pixel: bits, (ceil(H W / 8),) uint8."""

    bits: np.ndarray
    shape: tuple[int, int]

    @staticmethod
    def of(mask: np.ndarray) -> PackedMask:
        """Pack a mask, (H, W) bool."""
        return PackedMask(np.packbits(mask), (mask.shape[0], mask.shape[1]))

    def bools(self) -> np.ndarray:
        """The mask, (H, W) bool."""
        height, width = self.shape
        return np.unpackbits(self.bits, count=height * width).view(bool).reshape(height, width)


def read_mask(path: Path) -> np.ndarray:
    """(H, W) bool of a mask file: False where it is black. A JPEG's pixel counts from mid-grey on.

    Raises InputError when the file can't be read.
    """
    pixels, alpha = _channels(path)
    lossy = path.suffix.lower() in (".jpg", ".jpeg")
    colours = np.delete(pixels, alpha, axis=2) if alpha is not None and pixels.shape[2] > 1 else pixels
    return colours.max(axis=2) >= (_JPEG_VALID / 255 if lossy else np.finfo(np.float32).tiny)


def read_opaque(path: Path) -> np.ndarray | None:
    """(H, W) bool of an image file: True where its alpha channel is 1; None without such a channel."""
    if not has_alpha(path):
        return None
    pixels, alpha = _channels(path)
    return None if alpha is None else pixels[..., alpha] >= _OPAQUE


def has_alpha(path: Path) -> bool:
    """Whether an image file has an alpha channel, by its header alone; False for a file that can't be read."""
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        first_line(oiio.geterror)
        return False
    found = opened.spec().alpha_channel >= 0
    opened.close()
    return found


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write a mask (H, W) as PNG, atomically: 255 is valid, 0 masked."""
    write_grey_png(path, mask.astype(np.float32))


def filled(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image (H, W, C) with every masked pixel replaced by the nearest valid one; mask (H, W), not all False.

    What stood under the mask has no influence on the result.
    """
    import cv2

    if mask.all():
        return image
    kinds = cv2.DIST_L2, cv2.DIST_MASK_5
    _, labels = cv2.distanceTransformWithLabels((~mask).astype(np.uint8), *kinds, labelType=cv2.DIST_LABEL_PIXEL)
    places = np.zeros(int(labels.max()) + 1, np.int64)
    places[labels[mask]] = np.flatnonzero(mask)
    return image.reshape(-1, image.shape[2])[places[labels]].reshape(image.shape)


def touched(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """(height, width) bool: the pixels of a shrunk image to which any of `pixels`, (H, W) bool, contributes."""
    rows, columns = pixels.shape
    if (rows, columns) == (height, width):
        return pixels

    def sums(values: np.ndarray, size: int) -> np.ndarray:
        edges = np.arange(size + 1) * len(values) / size
        first, last = np.floor(edges[:-1]).astype(int), np.ceil(edges[1:]).astype(int)
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        return total[last] - total[first]

    return sums(sums(pixels.astype(float), height).T, width).T > 0


def shrunk_mask(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """The mask of the shrunk image: a pixel is valid if all that it averages is valid."""
    return ~touched(~mask, width, height)


def _channels(path: Path) -> tuple[np.ndarray, int | None]:
    """(H, W, C) float32 as stored, integers scaled to [0, 1], and which channel is alpha."""
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        reason = first_line(oiio.geterror)
        raise InputError(path, f"no readable image ({reason})", "a mask: black where pixels don't count")
    spec = opened.spec()
    pixels = opened.read_image(oiio.FLOAT)
    opened.close()
    if pixels is None:
        raise InputError(path, "an image cut short", "a mask: black where pixels don't count")
    pixels = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, spec.nchannels)
    return pixels, spec.alpha_channel if spec.alpha_channel >= 0 else None
