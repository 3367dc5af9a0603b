"""The photographs that a scene is made of: found in a folder, turned upright, shrunk, written for the stages after."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError, first_line
from dofbench.core.files import sha256_file, sha256_text
from dofbench.core.image_files.camera_files import is_camera_file, missing_package
from dofbench.core.image_files.coding import Coding
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import image_coding, image_size, read_exr, read_image, resize, write_exr, write_png
from dofbench.core.masks import filled, read_mask, read_opaque, shrunk_mask, write_mask
from dofbench.scenes.companions import photographs_of
from dofbench.scenes.found_masks import alpha_note, masks_beside, translucent
from dofbench.scenes.light import coding_notes, for_display, read_values
from dofbench.scenes.readers.exif_files import exif_by_file
from dofbench.scenes.readers.folders import IMAGE_SUFFIXES, other_files, view_names
from dofbench.scenes.scene import Alpha, Split
from dofbench.scenes.scene_masks import check_size

LEAST = 3
_LIGHT = "light"
# Folder of the masks of prepared photographs, beside them: FILE_NAME.png, as COLMAP reads them.
MASKS = "masks"


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph. name: of its view. source: its file. read: gives it upright, (H, W, 3) float32, encoded.

    camera, split: where its pose is known already; the camera is at the size that `read` gives. light: gives it as
    linear light, where the file is that. mask: gives its mask, (H, W) bool, upright, True for the pixels that count;
    those that don't are replaced by their nearest valid ones in what `read` and `light` give.
    """

    name: str
    source: Path
    read: Callable[[], np.ndarray]
    exif: Exif | None = None
    camera: Camera | None = None
    split: Split | None = None
    light: Callable[[], np.ndarray] | None = None
    mask: Callable[[], np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A photograph as the stages after see it: an 8-bit PNG of the longer side asked for or less.

    file_name: in the folder of photographs, a number in their order. width, height: its pixels. sharpness: variance of
    its Laplacian, 8-bit levels squared, which only says something beside the others'. light: the same picture as linear
    light, an EXR; None where the photograph is encoded. mask: file of its mask, None where no pixel is masked.
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
    """The photographs in a folder, by name; with sub-folders.

    images: the folder within `source`. Without it, where there are `images`, `images_4` and the like: the one with the
    largest photographs; else the source itself, without masks, depth and confidence maps (`companions.py`). alpha: what
    an alpha channel means. Raises InputError for no photographs, for fewer than three, and for
    those that a package which isn't installed would read.
    """
    folder, files, aside = photographs_of(source, images)
    if len(files) < LEAST:
        found = f"{len(files)} photographs" if len(files) != 1 else "one photograph"
        raise InputError(folder, found, f"at least {LEAST} ({', '.join(IMAGE_SUFFIXES)}), taken from different places")
    _require_packages(folder, files)
    names = view_names([file.relative_to(folder).as_posix() for file in files])
    exif = exif_by_file(source, dict(zip(names, files, strict=True)))
    codings = _codings(folder, dict(zip(names, files, strict=True)))
    photographs: list[Photograph] = []
    clear = {file for file in files if translucent(file)}
    for name, file, mask_file in zip(names, files, masks_beside(source, files), strict=True):
        upright, mask = Upright(file, codings[name].linear), None
        read: Callable[[], np.ndarray] = upright
        light: Callable[[], np.ndarray] | None = upright.light if upright.linear else None
        if mask_file is not None or (file in clear and alpha != "background"):
            mask = UprightMask(file, mask_file, file in clear and alpha != "background")
            read, light = Unmasked(read, mask), None if light is None else Unmasked(light, mask)
        photographs.append(Photograph(name, file, read, exif.get(name), light=light, mask=mask))
    masked = sum(one.mask is not None for one in photographs)
    notes = [f"masks of {masked} of {len(photographs)} photographs: no features there"] if masked else []
    return Found(
        photographs,
        (*coding_notes(codings), *notes, *filter(None, [alpha_note(len(clear), alpha)]), *aside, *_skipped(folder)),
    )


def _codings(folder: Path, files: Mapping[str, Path]) -> dict[str, Coding]:
    """The coding of each photograph, by name. Raises one InputError for all that can't be read."""
    found, errors = {}, []
    for name, file in files.items():
        try:
            found[name] = image_coding(file)
        except InputError as error:
            errors.append(error)
    if len(errors) > 1:
        first = f"{errors[0].subject}: {errors[0].found}"
        raise InputError(
            folder, f"{len(errors)} of {len(files)} photographs can't be read ({first})", errors[0].expected
        )
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
    """A note on the files in the folder that are no photographs, or second copies of one."""
    others = other_files(folder)
    copies = Counter(file.suffix for file in others if is_camera_file(file))
    rest = Counter(file.suffix or "without suffix" for file in others if not is_camera_file(file))
    notes = []
    if copies:
        notes.append(f"skipped {_counted(copies)}: the same photographs are there in another format")
    if rest:
        notes.append(f"skipped {_counted(rest)}: not read as photographs")
    return notes


def _counted(suffixes: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {suffix}" for suffix, count in sorted(suffixes.items()))


@dataclass(frozen=True)
class Upright:
    """Reads a photograph and turns it the way that EXIF's orientation says: (H, W, 3) float32, encoded.

    linear: the file holds linear light, which `light` gives; encoded it is clipped at 1.
    """

    file: Path
    linear: bool = False

    def __call__(self) -> np.ndarray:
        return for_display(self.light()) if self.linear else self._values()

    def light(self) -> np.ndarray:
        """Linear light, (H, W, 3) float32, not clipped. Raises ValueError for an encoded photograph."""
        if not self.linear:
            raise ValueError(f"{self.file}: expected linear light, found an encoded image")
        return self._values()

    def _values(self) -> np.ndarray:
        return turned(read_values(self.file, linear=self.linear), orientation(self.file))


@dataclass(frozen=True)
class UprightMask:
    """Reads a photograph's mask, turned as the photograph is: (H, W) bool, True for the pixels that count.

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
        if not mask.any():
            raise InputError(
                self.file or self.photograph, "a mask without a valid pixel", "some, or no such photograph"
            )
        return mask


@dataclass(frozen=True)
class Unmasked:
    """Reads a photograph, its masked pixels replaced by the nearest valid ones."""

    read: Callable[[], np.ndarray]
    mask: Callable[[], np.ndarray]

    def __call__(self) -> np.ndarray:
        return filled(self.read(), self.mask())


def orientation(file: Path) -> int:
    """EXIF's orientation of an image file, 1 to 8; 1, upright, where none is written, and for files that come upright
    (HEIC, AVIF, raw)."""
    if is_camera_file(file):
        return 1
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(file))
    if opened is None:
        first_line(oiio.geterror)
        return 1
    value = opened.spec().get_int_attribute("Orientation", 1)
    opened.close()
    return value if 1 <= value <= 8 else 1


def upright_size(file: Path) -> tuple[int, int]:
    """(width, height) of a photograph once it is turned upright, read from its header alone."""
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
    """Write every photograph as `folder/NUMBER.png`, at most `size` pixels on its longer side; what is there is kept.

    One of linear light is written beside that folder too, as light/NUMBER.exr, half floats. advance: called with the
    number done. Its mask, where it has one, is written as masks/NUMBER.png.png. Raises InputError for a photograph or a
    mask that can't be read.
    """
    prepared = []
    for index, photograph in enumerate(photographs):
        # COLMAP's list of pairs parts names by spaces, and a name may have one; a number hasn't.
        path = folder / f"{index:06d}.png"
        light = None if photograph.light is None else folder.parent / _LIGHT / f"{index:06d}.exr"
        if photograph.light is not None and light is not None:
            if not light.is_file():
                write_exr(light, _shrunk(photograph.light(), size), half=True)
            if not path.is_file():
                write_png(path, for_display(read_exr(light)))
        elif not path.is_file():
            write_png(path, _shrunk(photograph.read(), size))
        image = read_image(path)
        height, width = image.shape[:2]
        if min(width, height) < 16:
            raise InputError(photograph.source, f"{width}x{height} pixels", "a photograph of at least 16x16")
        mask = None if photograph.mask is None else folder.parent / MASKS / f"{path.name}.png"
        if photograph.mask is not None and mask is not None and not mask.is_file():
            write_mask(mask, shrunk_mask(photograph.mask(), width, height))
        camera = photograph.camera
        prepared.append(
            Prepared(
                photograph.name,
                path.name,
                width,
                height,
                sharpness(image),
                photograph.exif,
                None if camera is None else camera.resized(width, height),
                photograph.split,
                light,
                mask,
            )
        )
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
    """sha256 of each photograph's file, by name; with that of its mask where it has one."""
    return {photograph.name: _digest(photograph) for photograph in photographs}


def _digest(photograph: Photograph) -> str:
    content = sha256_file(photograph.source)
    if photograph.mask is None:
        return content
    return sha256_text(f"{content} {hashlib.sha256(np.packbits(photograph.mask()).tobytes()).hexdigest()}")
