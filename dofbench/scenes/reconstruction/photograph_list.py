"""The photographs that a scene is made of: found in a folder, turned upright, shrunk, written for the stages after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.exif import Exif
from dofbench.core.files import sha256_file
from dofbench.core.images import image_size, read_image, resize, write_png
from dofbench.scenes.exif_files import exif_by_file
from dofbench.scenes.folders import IMAGE_SUFFIXES, choose_folder, image_files, image_folders, view_names
from dofbench.scenes.scene import Split

LEAST = 3


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph. name: of its view. source: its file. read: gives it upright, (H, W, 3) float32, encoded.

    camera, split: where its pose is known already; the camera is at the size that `read` gives.
    """

    name: str
    source: Path
    read: Callable[[], np.ndarray]
    exif: Exif | None = None
    camera: Camera | None = None
    split: Split | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A photograph as the stages after see it: an 8-bit PNG of the longer side asked for or less.

    file_name: in the folder of photographs, a number in their order. width, height: its pixels. sharpness: variance of
    its Laplacian, 8-bit levels squared, which only says something beside the others'.
    """

    name: str
    file_name: str
    width: int
    height: int
    sharpness: float
    exif: Exif | None
    camera: Camera | None = None
    split: Split | None = None


def find_photographs(source: Path, images: str | None) -> list[Photograph]:
    """The photographs in a folder, by name; with sub-folders.

    images: the folder within `source`. Without it, where there are `images`, `images_4` and the like: the one with the
    largest photographs; else the source itself. Raises InputError for no photographs, and for fewer than three.
    """
    folder = source
    if images is not None or image_folders(source):
        folder = choose_folder(source, width=None, images=images, habit=())
    files = image_files(folder)
    if len(files) < LEAST:
        found = f"{len(files)} photographs" if len(files) != 1 else "one photograph"
        raise InputError(folder, found, f"at least {LEAST} ({', '.join(IMAGE_SUFFIXES)}), taken from different places")
    names = view_names([file.relative_to(folder).as_posix() for file in files])
    exif = exif_by_file(source, dict(zip(names, files, strict=True)))
    return [Photograph(name, file, Upright(file), exif.get(name)) for name, file in zip(names, files, strict=True)]


@dataclass(frozen=True)
class Upright:
    """Reads a photograph and turns it the way that EXIF's orientation says: (H, W, 3) float32, encoded."""

    file: Path

    def __call__(self) -> np.ndarray:
        return turned(read_image(self.file), orientation(self.file))


def orientation(file: Path) -> int:
    """EXIF's orientation of an image file, 1 to 8; 1, upright, where none is written."""
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(file))
    if opened is None:
        oiio.geterror()
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

    advance: called with the number done. Raises InputError for a photograph that can't be read.
    """
    prepared = []
    for index, photograph in enumerate(photographs):
        # COLMAP's list of pairs parts names by spaces, and a name may have one; a number hasn't.
        path = folder / f"{index:06d}.png"
        if not path.is_file():
            image = photograph.read()
            height, width = image.shape[:2]
            share = min(1.0, size / max(width, height))
            write_png(path, resize(image, max(1, round(width * share)), max(1, round(height * share))))
        image = read_image(path)
        height, width = image.shape[:2]
        if min(width, height) < 16:
            raise InputError(photograph.source, f"{width}x{height} pixels", "a photograph of at least 16x16")
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
            )
        )
        advance(index + 1)
    return prepared


def sharpness(image: np.ndarray) -> float:
    """Variance of the Laplacian of an encoded image (H, W, 3), in 8-bit levels squared (Pech-Pacheco et al. 2000)."""
    import cv2

    grey = (image @ np.array([0.299, 0.587, 0.114], np.float32)) * np.float32(255.0)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def digests(photographs: Sequence[Photograph]) -> dict[str, str]:
    """sha256 of each photograph's file, by name."""
    return {photograph.name: sha256_file(photograph.source) for photograph in photographs}
