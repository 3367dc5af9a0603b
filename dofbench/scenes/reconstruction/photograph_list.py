"""Photographs of a scene: found in a folder, turned upright, shrunk, written for the following stages."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file, sha256_text
from dofbench.core.image_files.camera_files import is_camera_file, missing_package
from dofbench.core.image_files.coding import Coding
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import image_coding, image_size, read_exr, read_image, resize, write_exr, write_png
from dofbench.core.masks import filled, read_mask, read_opaque, shrunk_mask, write_mask
from dofbench.scenes.found_masks import alpha_note, masks_beside, translucent
from dofbench.scenes.on_disk import (
    ReadsImage,
    check_size,
    coding_notes,
    for_display,
    read_values,
    with_valid_pixel,
)
from dofbench.scenes.readers.exif_files import exif_by_file
from dofbench.scenes.readers.folders import IMAGE_SUFFIXES, image_header, other_files, photographs_of, view_names
from dofbench.scenes.scene import Alpha, Split

LEAST = 3
_LIGHT = "light"
# Folder of the masks of prepared photographs, beside them: FILE_NAME.png, as COLMAP reads them.
MASKS = "masks"
Read = Callable[[], np.ndarray]


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph. name: of its view. read: gives it upright, (H, W, 3) float32, encoded.

    camera, split: where known, the camera at the size that `read` gives. light: gives linear light, where the file has
    it. mask: gives (H, W) bool, upright, True for valid pixels; `read` and `light` replace the others by their nearest
    valid ones.
    """

    name: str
    source: Path
    read: Read
    exif: Exif | None = None
    camera: Camera | None = None
    split: Split | None = None
    light: Read | None = None
    mask: Read | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A photograph as the following stages see it: an 8-bit PNG, shrunk.

    file_name: a number in their order. sharpness: variance of its Laplacian, 8-bit levels squared, relative to the
    others'. light: an EXR of linear light; None where the photograph is encoded. mask: its file, None without.
    """

    name: str
    file_name: str
    width: int
    height: int
    sharpness: float
    exif: Exif | None
    camera: Camera | None = None
    split: Split | None = None
    light: Path | None = None
    mask: Path | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """The photographs of a folder, and notes on what was converted or skipped."""

    photographs: list[Photograph]
    notes: tuple[str, ...]


def find_photographs(source: Path, images: str | None, alpha: Alpha | None = None) -> Found:
    """Find the photographs in a folder and its sub-folders, by name, without masks and depth maps.

    images: the folder within `source`; see `photographs_of`. alpha: meaning of an alpha channel. Raises InputError for
    fewer than three photographs, and for files whose package isn't installed.
    """
    folder, files, aside = photographs_of(source, images)
    if len(files) < LEAST:
        found = f"{len(files)} photographs" if len(files) != 1 else "one photograph"
        raise InputError(folder, found, f"at least {LEAST} ({', '.join(IMAGE_SUFFIXES)}), taken from different places")
    _require_packages(folder, files)
    names = view_names([file.relative_to(folder).as_posix() for file in files])
    by_name = dict(zip(names, files, strict=True))
    exif, codings = exif_by_file(source, by_name), _codings(folder, by_name)
    photographs: list[Photograph] = []
    clear = {file for file in files if translucent(file)}
    for name, file, mask_file in zip(names, files, masks_beside(source, files), strict=True):
        upright, mask = Upright(file, codings[name].linear), None
        read: Read = upright
        light: Read | None = upright.light if upright.linear else None
        by_alpha = file in clear and alpha != "background"
        if mask_file is not None or by_alpha:
            mask = UprightMask(file, mask_file, by_alpha)
            read, light = Unmasked(read, mask), None if light is None else Unmasked(light, mask)
        photographs.append(Photograph(name, file, read, exif.get(name), light=light, mask=mask))
    masked = sum(one.mask is not None for one in photographs)
    note = f"masks of {masked} of {len(photographs)} photographs: no features there" if masked else ""
    notes = [*coding_notes(codings), note, alpha_note(len(clear), alpha), *aside, *_skipped(folder)]
    return Found(photographs, tuple(filter(None, notes)))


def _codings(folder: Path, files: Mapping[str, Path]) -> dict[str, Coding]:
    """The coding of each photograph, by name. Raises one InputError for all unreadable ones."""
    found, errors = {}, []
    for name, file in files.items():
        try:
            found[name] = image_coding(file)
        except InputError as error:
            errors.append(error)
    if len(errors) > 1:
        first = f"{errors[0].subject}: {errors[0].found}"
        those = f"{len(errors)} of {len(files)} photographs can't be read ({first})"
        raise InputError(folder, those, errors[0].expected)
    if errors:
        raise errors[0]
    return found


def _require_packages(folder: Path, files: Sequence[Path]) -> None:
    unread: dict[str, list[Path]] = {}
    for file in files:
        if is_camera_file(file) and (package := missing_package(file)):
            unread.setdefault(package, []).append(file)
    for package, those in unread.items():
        kinds = ", ".join(sorted({file.suffix for file in those}))
        found = f"{len(those)} of {len(files)} photographs are {kinds}, for which {package} isn't installed"
        raise InputError(folder, found, "pip install 'dofbench[photographs]'; or photographs as JPEG or PNG")


def _skipped(folder: Path) -> list[str]:
    """Notes on files that are no photographs, or second copies of one."""
    others = other_files(folder)
    copies = Counter(file.suffix for file in others if is_camera_file(file))
    rest = Counter(file.suffix or "without suffix" for file in others if not is_camera_file(file))
    reasons = {"the same photographs are there in another format": copies, "not read as photographs": rest}
    return [
        f"skipped {', '.join(f'{count} {suffix}' for suffix, count in sorted(suffixes.items()))}: {why}"
        for why, suffixes in reasons.items()
        if suffixes
    ]


@dataclass(frozen=True)
class Upright(ReadsImage):
    """Reads a photograph and turns it by EXIF's orientation."""

    file: Path
    linear: bool = False

    def _values(self) -> np.ndarray:
        return turned(read_values(self.file, linear=self.linear), orientation(self.file))


@dataclass(frozen=True)
class UprightMask:
    """Reads a photograph's mask, turned as the photograph is: (H, W) bool, True for valid pixels.

    file: of the mask, of the size of the photograph as stored or upright. alpha: whether transparent pixels are masked.
    """

    photograph: Path
    file: Path | None
    alpha: bool

    def __call__(self) -> np.ndarray:
        size, upright = image_size(self.photograph), upright_size(self.photograph)
        mask = np.ones(upright[::-1], bool)
        if self.file is not None:
            found = image_size(self.file)
            # Whoever saw the photograph upright drew the mask so.
            as_shown = abs(found[0] / found[1] - upright[0] / upright[1]) < abs(found[0] / found[1] - size[0] / size[1])
            check_size(self.file, upright if as_shown else size)
            stored = read_mask(self.file)
            mask &= shrunk_mask(stored if as_shown else turned(stored, orientation(self.photograph)), *upright)
        opaque = read_opaque(self.photograph) if self.alpha else None
        if opaque is not None:
            mask &= turned(opaque, orientation(self.photograph))
        return with_valid_pixel(mask, self.file or self.photograph)


@dataclass(frozen=True)
class Unmasked:
    """Reads a photograph, its masked pixels replaced by the nearest valid ones."""

    read: Read
    mask: Read

    def __call__(self) -> np.ndarray:
        return filled(self.read(), self.mask())


def orientation(file: Path) -> int:
    """EXIF's orientation, 1 to 8; 1 (upright) without, and for formats decoded upright (HEIC, AVIF, raw)."""
    header = None if is_camera_file(file) else image_header(file)
    value = 1 if header is None else header.get_int_attribute("Orientation", 1)
    return value if 1 <= value <= 8 else 1


def upright_size(file: Path) -> tuple[int, int]:
    """(width, height) of a photograph turned upright, from its header alone."""
    width, height = image_size(file)
    return (height, width) if orientation(file) in (5, 6, 7, 8) else (width, height)


def turned(image: np.ndarray, orientation: int) -> np.ndarray:
    """(H, W, C) as stored to upright: 2 mirrored, 3 by 180 degrees, 6 a quarter to the right, ... (EXIF 2.3, 4.6.4)."""
    if orientation in (5, 6, 7, 8):
        image = image.transpose(1, 0, 2)
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return np.ascontiguousarray(image)


def prepare(
    photographs: Sequence[Photograph], folder: Path, size: int, advance: Callable[[int], None]
) -> list[Prepared]:
    """Write every photograph as `folder/NUMBER.png`, at most `size` pixels on its longer side; existing files are kept.

    Linear light is written as light/NUMBER.exr (half floats), a mask as masks/NUMBER.png.png, both next to `folder`.
    advance: called with the number done. Raises InputError for an unreadable photograph or mask.
    """
    prepared = []
    for index, photograph in enumerate(photographs):
        # COLMAP's list of pairs parts names by spaces, and a name may have one; a number hasn't.
        path = folder / f"{index:06d}.png"
        light = mask = None
        if photograph.light is not None:
            light = folder.parent / _LIGHT / f"{index:06d}.exr"
            if not light.is_file():
                write_exr(light, _shrunk(photograph.light(), size), half=True)
        if not path.is_file():
            write_png(path, _shrunk(photograph.read(), size) if light is None else for_display(read_exr(light)))
        image = read_image(path)
        height, width = image.shape[:2]
        if min(width, height) < 16:
            raise InputError(photograph.source, f"{width}x{height} pixels", "a photograph of at least 16x16")
        if photograph.mask is not None:
            mask = folder.parent / MASKS / f"{path.name}.png"
            if not mask.is_file():
                write_mask(mask, shrunk_mask(photograph.mask(), width, height))
        camera = None if photograph.camera is None else photograph.camera.resized(width, height)
        about = sharpness(image), photograph.exif, camera, photograph.split, light, mask
        prepared.append(Prepared(photograph.name, path.name, width, height, *about))
        advance(index + 1)
    return prepared


def _shrunk(image: np.ndarray, size: int) -> np.ndarray:
    height, width = image.shape[:2]
    share = min(1.0, size / max(width, height))
    return resize(image, max(1, round(width * share)), max(1, round(height * share)))


def sharpness(image: np.ndarray) -> float:
    """Variance of the Laplacian of an encoded image (H, W, 3), in 8-bit levels squared (Pech-Pacheco et al. 2000)."""
    import cv2

    grey = (image @ np.array([0.299, 0.587, 0.114], np.float32)) * np.float32(255.0)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def digests(photographs: Sequence[Photograph]) -> dict[str, str]:
    """sha256 of each photograph's file, together with its mask's content, by name."""
    return {photograph.name: _digest(photograph) for photograph in photographs}


def _digest(photograph: Photograph) -> str:
    content = sha256_file(photograph.source)
    if photograph.mask is None:
        return content
    return sha256_text(f"{content} {hashlib.sha256(np.packbits(photograph.mask()).tobytes()).hexdigest()}")
