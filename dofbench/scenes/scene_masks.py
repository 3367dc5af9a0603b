"""A view's mask on disk, read as its image is: undistorted and resized."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import image_size
from dofbench.core.masks import read_mask, read_opaque, shrunk_mask
from dofbench.scenes.undistort import Intrinsics, source_coordinates, undistorted

# Of a mask larger than its image, such as one of the full size next to images_4: relative difference of the shapes.
_ASPECT = 0.01
# Lanczos takes 8 x 8 samples, of which three lie to the left and above.
_SAMPLES, _BEFORE = 8, 3


@dataclass(frozen=True)
class MaskOnDisk:
    """Reads a view's mask: (height, width) bool, True for the pixels that count, undistorted and resized as the image.

    A resampled pixel counts if everything that it is computed from does. file: of the mask. image: its image file, of
    the intrinsics' size. alpha: whether the image's alpha channel masks too.
    """

    image: Path
    file: Path | None
    alpha: bool
    intrinsics: Intrinsics
    width: int
    height: int

    def __call__(self) -> np.ndarray:
        mask = shrunk_mask(undistort_mask(self.as_stored(), self.intrinsics), self.width, self.height)
        return _with_a_pixel(mask, self.file or self.image)

    def as_stored(self) -> np.ndarray:
        """The mask at the size of the image file, before anything is resampled. Raises InputError for a mask without a
        valid pixel, or of another shape than its image."""
        size = self.intrinsics.width, self.intrinsics.height
        mask = np.ones(size[::-1], bool) if self.file is None else _of_size(read_mask(self.file), size, self.file)
        opaque = read_opaque(self.image) if self.alpha else None
        return _with_a_pixel(mask if opaque is None else mask & opaque, self.file or self.image)


def undistort_mask(mask: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """The mask (H, W) as `undistort_image` takes the image: a pixel is valid if all its samples are."""
    import cv2

    if not intrinsics.distorted:
        return mask
    reached = cv2.dilate(
        (~mask).astype(np.uint8),
        np.ones((_SAMPLES, _SAMPLES), np.uint8),
        anchor=(_BEFORE, _BEFORE),
        borderType=cv2.BORDER_REPLICATE,
    )
    at = source_coordinates(intrinsics, undistorted(intrinsics)) - np.float32(0.5)
    # OpenCV rounds coordinates to 1/32 pixel before it takes their whole part.
    whole = np.floor(np.round(at * 32) / 32).astype(np.int64)
    column, row = np.clip(whole, 0, (mask.shape[1] - 1, mask.shape[0] - 1)).transpose(2, 0, 1)
    return reached[row, column] == 0


def check_size(file: Path, size: tuple[int, int]) -> None:
    """Raise InputError unless the mask file has the image's (width, height), or is larger and of the same shape."""
    found = image_size(file)
    alike = abs(found[0] / found[1] / (size[0] / size[1]) - 1) <= _ASPECT
    if found != size and not (alike and found[0] >= size[0] and found[1] >= size[1]):
        raise InputError(file, f"a mask of {found[0]}x{found[1]} pixels", f"{size[0]}x{size[1]}, as its image")


def _of_size(mask: np.ndarray, size: tuple[int, int], file: Path) -> np.ndarray:
    check_size(file, size)
    return shrunk_mask(mask, *size)


def _with_a_pixel(mask: np.ndarray, file: Path) -> np.ndarray:
    if not mask.any():
        raise InputError(file, "a mask without a valid pixel", "some pixels that aren't black, or no such view")
    return mask
