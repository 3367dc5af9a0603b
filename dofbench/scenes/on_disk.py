"""Images, masks and depth maps of a view, read from disk when called: without distortion, resized.

The readers are classes, not closures, so that a view can be sent to another process.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import USUAL, Coding
from dofbench.core.images import image_size, read_coded, resize
from dofbench.core.lens import GAMMA
from dofbench.core.masks import filled, read_mask, read_opaque, shrunk_mask
from dofbench.optics.tone import encode
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.undistort import Intrinsics, sample_depth, source_coordinates, undistort_image, undistorted

# Of a mask larger than its image, such as one of the full size next to images_4: relative difference of the shapes.
_ASPECT = 0.01
# Lanczos takes 8 x 8 samples, of which three lie to the left and above.
_SAMPLES, _BEFORE = 8, 3
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of sRGB's primaries (IEC 61966-2-1)
_NOISE = 0.01  # of white; the noise of a camera's black level is below this


class ReadsImage:
    """Base of a callable that reads the image `file`, (H, W, 3) float32, encoded. linear: the file holds linear light;
    encoded it is clipped at 1."""

    file: Path
    linear: bool

    def __call__(self) -> np.ndarray:
        return for_display(self.light()) if self.linear else self._values()

    def light(self) -> np.ndarray:
        """Linear light, (H, W, 3) float32, not clipped. Raises ValueError for an encoded image."""
        if not self.linear:
            raise ValueError(f"{self.file}: expected linear light, found an encoded image")
        return self._values()

    def _values(self) -> np.ndarray:
        raise NotImplementedError


@dataclass(frozen=True)
class MaskOnDisk:
    """Reads a view's mask: (height, width) bool, True for valid pixels, undistorted and resized as the image.

    A resampled pixel is valid if all its samples are. file: of the mask. image: its image file, of the intrinsics'
    size. alpha: whether the image's alpha channel masks too.
    """

    image: Path
    file: Path | None
    alpha: bool
    intrinsics: Intrinsics
    width: int
    height: int

    def __call__(self) -> np.ndarray:
        mask = shrunk_mask(undistort_mask(self.as_stored(), self.intrinsics), self.width, self.height)
        return with_valid_pixel(mask, self.file or self.image)

    def as_stored(self) -> np.ndarray:
        """The mask at the image file's size, not resampled. Raises InputError for one of another shape than its image,
        or without a valid pixel."""
        size = self.intrinsics.width, self.intrinsics.height
        mask = np.ones(size[::-1], bool)
        if self.file is not None:
            stored = read_mask(self.file)
            check_size(self.file, size)
            mask = shrunk_mask(stored, *size)
        opaque = read_opaque(self.image) if self.alpha else None
        return with_valid_pixel(mask if opaque is None else mask & opaque, self.file or self.image)


@dataclass(frozen=True)
class ImageOnDisk(ReadsImage):
    """Reads a view's image. mask: its masked pixels are first replaced by the nearest valid ones."""

    file: Path
    intrinsics: Intrinsics
    width: int
    height: int
    mask: MaskOnDisk | None = None
    linear: bool = False

    def _values(self) -> np.ndarray:
        image = read_values(self.file, linear=self.linear)
        expected = (self.intrinsics.height, self.intrinsics.width)
        if image.shape[:2] != expected:
            size = f"{image.shape[1]}x{image.shape[0]} pixels"
            raise InputError(self.file, size, f"{expected[1]}x{expected[0]}, as when the scene was loaded")
        if self.mask is not None:
            image = filled(image, self.mask.as_stored())
        return resize(undistort_image(image, self.intrinsics, light=self.linear), self.width, self.height)


@dataclass(frozen=True)
class DepthOnDisk:
    """Reads z-depth and samples it (nearest) at the view's pixel centres: (height, width) float32, 0 unknown."""

    file: Path
    unit: float
    intrinsics: Intrinsics
    width: int
    height: int

    def __call__(self) -> np.ndarray:
        target = undistorted(self.intrinsics).resized(self.width, self.height)
        return sample_depth(read_depth(self.file, self.unit), self.intrinsics, target)


def undistort_mask(mask: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """The mask (H, W) as `undistort_image` takes the image: a pixel is valid if all its samples are."""
    import cv2

    if not intrinsics.distorted:
        return mask
    samples, anchor = np.ones((_SAMPLES, _SAMPLES), np.uint8), (_BEFORE, _BEFORE)
    reached = cv2.dilate((~mask).astype(np.uint8), samples, anchor=anchor, borderType=cv2.BORDER_REPLICATE)
    at = source_coordinates(intrinsics, undistorted(intrinsics)) - np.float32(0.5)
    # OpenCV rounds coordinates to 1/32 pixel before it takes their whole part.
    whole = np.floor(np.round(at * 32) / 32).astype(np.int64)
    column, row = np.clip(whole, 0, (mask.shape[1] - 1, mask.shape[0] - 1)).transpose(2, 0, 1)
    return reached[row, column] == 0


def check_size(file: Path, size: tuple[int, int]) -> None:
    """Raise InputError unless a mask file has its image's (width, height), or is larger and of the same shape."""
    found = image_size(file)
    alike = abs(found[0] / found[1] / (size[0] / size[1]) - 1) <= _ASPECT
    if found != size and not (alike and found[0] >= size[0] and found[1] >= size[1]):
        raise InputError(file, f"a mask of {found[0]}x{found[1]} pixels", f"{size[0]}x{size[1]}, as its image")


def with_valid_pixel(mask: np.ndarray, file: Path) -> np.ndarray:
    """The mask itself. Raises InputError about `file` for one without a valid pixel."""
    if not mask.any():
        raise InputError(file, "a mask without a valid pixel", "some pixels that aren't black, or no such view")
    return mask


def read_values(file: Path, *, linear: bool) -> np.ndarray:
    """An image's values, (H, W, 3) float32: encoded, or linear light, not negative and not clipped.

    linear: as `image_coding` said. Raises InputError for a file that has changed since, light that is not finite, and
    pixels of negative luminance. Single channels may be negative (colours outside the gamut); they become 0.
    """
    values, coding = read_coded(file)
    if coding.linear is not linear:
        raise InputError(file, f"an image in {coding.name}", "the colour space that it had when it was found")
    if not linear:
        return values
    if wrong := int((~np.isfinite(values)).any(axis=2).sum()):
        raise InputError(file, f"light that is not finite in {wrong} pixels", "a finite number for every pixel")
    if dark := int((values @ _LUMINANCE < -_NOISE).sum()):
        raise InputError(file, f"light of negative luminance in {dark} pixels", "0 or more, but for noise around black")
    return np.maximum(values, np.float32(0.0))


def for_display(light: np.ndarray, gamma: float = GAMMA) -> np.ndarray:
    """Encode linear light to [0, 1] by the pure power, clipped at 1. float32."""
    return encode(np.clip(light, 0.0, 1.0), gamma).astype(np.float32)


def clipped_pixels(light: np.ndarray) -> int:
    """Count pixels of linear light with a channel above 1, which `for_display` clips."""
    return int((light > 1.0).any(axis=2).sum())


def coding_notes(codings: Mapping[str, Coding]) -> list[str]:
    """A sentence for every colour space other than sRGB among a scene's images. codings: by image."""
    notes = []
    for coding, number in Counter(codings.values()).items():
        what = f"{number} of {len(codings)} images are in {coding.name}"
        if coding.linear:
            converted = "" if coding.is_usual else "; converted to the primaries of sRGB"
            kept = f"kept as light for blur, else encoded as light ** (1 / {GAMMA:g}) and clipped at 1"
            notes.append(f"{what}: {kept}{converted}")
        elif coding != USUAL:
            notes.append(f"{what}: converted to sRGB")
    return notes
