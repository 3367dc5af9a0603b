"""Match names in COLMAP models, transforms.json, exif.csv and split files to image files.

The names are relative to some folder, and the files may since have been scaled into another folder and format. The
first of these steps that finds an image decides:

1. the whole path;
2. the whole path, upper and lower case of its suffix aside (`a.PNG` for `a.png`);
3. the whole path without suffix (`a.jpg` for `a.png`, or for `a`);
4. to 6., where a name may be the end of a path (`partial`): the same three for its last parts (`a.png` for
   `images/left/a.png`).

A step that finds several images makes the name ambiguous: neither a later step nor an order decides between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from dofbench.core.names import inside

# What photographs are called, readable or not: a model may name the raw file of the PNG that is here. Of "frame.001"
# nothing is a suffix.
_SUFFIXES = frozenset(
    ".png .jpg .jpeg .jpe .jfif .jp2 .j2k .tif .tiff .bmp .webp .exr .hdr .gif .ppm .pgm .pnm .pfm .tga .dpx .heic "
    ".heif .avif .jxl .dng .cr2 .cr3 .crw .nef .nrw .arw .srf .sr2 .raf .orf .rw2 .pef .srw .raw .3fr .iiq .x3f".split()
)


def plain(name: str) -> str:
    """A path as the files have it: '/' between its parts, without './'."""
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def plain_inside(name: object, subject: object) -> str:
    """`plain`, of a path inside its folder. Raises InputError about `subject`, the file that brings it, for others."""
    return inside(plain(name) if isinstance(name, str) and name else name, subject)


def without_suffix(name: str) -> str:
    """The path without its suffix, if that is one of a photograph."""
    suffix = PurePosixPath(name).suffix
    return name[: -len(suffix)] if suffix.lower() in _SUFFIXES else name


def _suffix_in_lower_case(name: str) -> str:
    stem = without_suffix(name)
    return stem + name[len(stem) :].lower()


_STEPS = (str, _suffix_in_lower_case, without_suffix)


@dataclass(frozen=True)
class Match:
    """Images that a name may mean, as indices; `step` counts from 0, the surest. No image where nothing fits."""

    step: int
    images: tuple[int, ...]

    @property
    def other_suffix(self) -> bool:
        """Whether the suffix played no part."""
        return self.step % len(_STEPS) == len(_STEPS) - 1


class ImageNames:
    """Images by name.

    names: of each image, by which it is known, the surest first: all images have equally many. partial: whether a name
    may be the end of an image's.
    """

    def __init__(self, names: Sequence[Sequence[str]], *, partial: bool = False) -> None:
        self._tables: list[dict[str, list[int]]] = []
        for ends in (False, True) if partial else (False,):
            for tier in zip(*names, strict=True):
                for step in _STEPS:
                    self._tables.append(_table([step(plain(name)) for name in tier], ends))

    def find(self, name: str) -> Match:
        """The images that `name` (parts separated by '/' or back-slash) means; several where it is ambiguous."""
        name = plain(name)
        for number, table in enumerate(self._tables):
            if images := table.get(_STEPS[number % len(_STEPS)](name)):
                return Match(number, tuple(images))
        return Match(len(self._tables), ())


def _table(names: Sequence[str], ends: bool) -> dict[str, list[int]]:
    """Indices by name or, with `ends`, by each of its ends."""
    table: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        parts = name.split("/")
        for start in range(1, len(parts)) if ends else (0,):
            table.setdefault("/".join(parts[start:]), []).append(index)
    return table
