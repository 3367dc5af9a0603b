"""Masks of a scene's views: named in transforms.json, in a folder masks/ next to the images, or an alpha channel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import image_size
from dofbench.core.masks import has_alpha, read_mask, read_opaque, shrunk_mask
from dofbench.scenes.folders import IMAGE_SUFFIXES, image_files, listed
from dofbench.scenes.scene import Scene, SceneView
from dofbench.scenes.undistort import Intrinsics, source_coordinates, undistorted

# What an alpha channel means: a mask, or the share of a background, which is black.
Alpha = Literal["mask", "background"]
ALPHAS: tuple[Alpha, ...] = ("mask", "background")
FOLDER = "masks"
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


def with_masks(scene: Scene, alpha: Alpha | None) -> Scene:
    """The scene with the masks that lie in a folder masks/ or in alpha channels, and with notes that say so.

    A mask that transforms.json names is there already, and goes before the folder. alpha: what an alpha channel means;
    None is a mask, with a note on the other choice. Raises InputError for a mask of another shape than its image, and
    for one that may belong to several images.
    """
    from dofbench.scenes.views import ImageOnDisk

    images = {view.name: view.image for view in scene.views if isinstance(view.image, ImageOnDisk)}
    beside = masks_beside(scene.root, [view.source for view in scene.views])
    clear = {view.name for view in scene.views if view.name in images and _translucent(view.source)}
    views, found = [], []
    for view, file in zip(scene.views, beside, strict=True):
        image = images.get(view.name)
        if image is None:
            views.append(view)
            continue
        named = image.mask.file if image.mask is not None else None
        masks = view.name in clear and alpha != "background"
        if named is None and file is None and not masks:
            views.append(view)
            continue
        if named is None and file is not None:
            check_size(file, (image.intrinsics.width, image.intrinsics.height))
        mask = MaskOnDisk(view.source, named or file, masks, image.intrinsics, image.width, image.height)
        views.append(replace(view, mask=mask, image=replace(image, mask=mask)))
        found.append(view)
    return replace(scene, views=tuple(views)).noted(
        _masks_note([view.name for view in views if view.mask is not None], scene.views),
        _alpha_note(len(clear), alpha),
        "" if found or any(beside) else _strangers(scene),
    )


def masks_beside(root: Path, files: Sequence[Path]) -> list[Path | None]:
    """The mask of each image file in a folder masks/ below `root`, at the same place as the image: COLMAP's NAME.SUFFIX
    followed by .png, or NAME with any image suffix. None where there is none. Raises InputError if it isn't clear whose
    mask a file is."""
    names = Counter((file.parent, file.stem) for file in files)
    found: list[Path | None] = []
    for file in files:
        mask = None
        for place in _places(root, file):
            exact = place.with_name(f"{place.name}.png")
            alike = [exact] if exact.is_file() else _alike(place)
            if len(alike) > 1:
                raise InputError(place.parent, f"{listed(sorted(path.name for path in alike))}", f"one mask of {file}")
            if alike and alike[0] != exact and names[file.parent, file.stem] > 1:
                found_as = f"{alike[0].name} for several images called {file.stem}"
                raise InputError(place.parent, found_as, f"their masks as {exact.name} and the like")
            mask = mask or (alike[0] if alike else None)
        found.append(mask)
    return found


def _places(root: Path, file: Path) -> Iterator[Path]:
    """Where the mask of an image may be, but for its suffix: images/a/b.jpg has it at masks/a/b.jpg."""
    try:
        parts = file.relative_to(root).parts
    except ValueError:
        root, parts = file.parent.parent, file.parts[-2:]
    for depth, part in enumerate(parts):
        rest = parts[depth + 1 :] or parts[-1:]
        scaled = part.rpartition("_")[2]
        # Masks next to images_4 may be as small as those.
        for folder in (*([f"{FOLDER}_{scaled}"] if scaled.isdigit() else []), FOLDER):
            yield root.joinpath(*parts[:depth], folder, *rest)


def _alike(place: Path) -> list[Path]:
    """The image files that have the name of `place` with any suffix."""
    if not place.parent.is_dir():
        return []
    return [
        path for path in place.parent.iterdir() if path.stem == place.stem and path.suffix.lower() in IMAGE_SUFFIXES
    ]


def _translucent(file: Path) -> bool:
    opaque = read_opaque(file) if has_alpha(file) else None
    return opaque is not None and not bool(opaque.all())


def _of_size(mask: np.ndarray, size: tuple[int, int], file: Path) -> np.ndarray:
    check_size(file, size)
    return shrunk_mask(mask, *size)


def _with_a_pixel(mask: np.ndarray, file: Path) -> np.ndarray:
    if not mask.any():
        raise InputError(file, "a mask without a valid pixel", "some pixels that aren't black, or no such view")
    return mask


def _masks_note(masked: Sequence[str], views: Sequence[SceneView]) -> str:
    if not masked:
        return ""
    without = [view.name for view in views if view.name not in set(masked)]
    note = f"masks of {len(masked)} of {len(views)} views: masked pixels are neither trained on nor scored"
    return f"{note}; unmasked: {listed(without)}" if without else note


def _alpha_note(count: int, alpha: Alpha | None) -> str:
    if not count:
        return ""
    what = f"alpha channel of {count} image{'s' if count > 1 else ''}"
    if alpha == "background":
        return f"{what}: composited over black"
    return f"{what}: taken as a mask" + ("" if alpha else "; --alpha-channel background composites over black instead")


def _strangers(scene: Scene) -> str:
    folder = scene.root / FOLDER
    files = image_files(folder) if folder.is_dir() else []
    if not files:
        return ""
    return f"{FOLDER}/ holds {len(files)} images, none of them named after an image of the scene: not used"
