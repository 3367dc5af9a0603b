"""Which image folder of a scene to read, which file belongs to which camera, what the views are called."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from dofbench.core.errors import InputError
from dofbench.core.image_files.camera_files import CAMERA_SUFFIXES, is_camera_file
from dofbench.core.images import image_size
from dofbench.core.readable import check_file
from dofbench.scenes.readers.name_match import ImageNames

_PLAIN_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".exr", ".hdr")
IMAGE_SUFFIXES = (*_PLAIN_SUFFIXES, *CAMERA_SUFFIXES)
_TEXT_SUFFIXES = (".csv", ".json", ".md", ".txt", ".xml", ".xmp", ".toml", ".yaml")
_HOLD = re.compile(r"hold ?= ?(\d+)")
_FACTOR = re.compile(r"_\d+$")
_SEVERAL = 3
# COLMAP numbers what it makes inside these: sparse/0, and undistorted images with their model in dense/0.
_MADE_BY_COLMAP = ("sparse", "dense")


def scene_name(folder: Path) -> str:
    """What a scene is called: after its folder, or the first one above that a person named and not COLMAP."""
    here = folder.resolve()
    named = here
    while named.name in _MADE_BY_COLMAP or (named.name.isdigit() and named.parent.name in _MADE_BY_COLMAP):
        named = named.parent
    return named.name or here.name


def listed(names: Iterable[str]) -> str:
    """A few names for a message: 'a, b, c and 5 more'."""
    names = list(names)
    more = f" and {len(names) - _SEVERAL} more" if len(names) > _SEVERAL else ""
    return ", ".join(names[:_SEVERAL]) + more


def image_files(folder: Path) -> list[Path]:
    """Image files under `folder`, with sub-folders, sorted by relative path; hidden ones are excluded.

    Of one photograph that lies there both as the camera stored it (HEIC, AVIF, raw) and in a plain format, by the same
    name but for the suffix, the plain one. Raises InputError for one that is no regular file: a FIFO, a socket, a link
    to nothing.
    """
    found = []
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(parent, name) for name in names if _is_image(name)]
    for path in found:
        check_file(path, "an image file")
    plain = {path.with_suffix("") for path in found if not is_camera_file(path)}
    found = [path for path in found if not (is_camera_file(path) and path.with_suffix("") in plain)]
    return sorted(found, key=lambda path: path.relative_to(folder).as_posix())


def other_files(folder: Path) -> list[Path]:
    """Files under `folder`, with sub-folders, that `image_files` passes over; without hidden ones and without text."""
    taken = set(image_files(folder))
    found = []
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(parent, name) for name in names if not name.startswith(".")]
    return sorted(path for path in found if path not in taken and path.suffix.lower() not in _TEXT_SUFFIXES)


def image_folders(root: Path, base: str = "images") -> dict[int, Path]:
    """Folders `base` (factor 1) and `base_N` (factor N) that hold an image, by factor."""
    pattern = re.compile(rf"{re.escape(PurePosixPath(base).name)}(?:_(\d+))?")
    parent = root / PurePosixPath(base).parent
    folders = {}
    for folder in sorted(parent.iterdir()) if parent.is_dir() else []:
        match = pattern.fullmatch(folder.name)
        if match and folder.is_dir() and image_files(folder):
            folders[int(match[1] or 1)] = folder
    return folders


def choose_folder(
    root: Path, *, width: int | None, images: str | None, habit: Sequence[int], base: str = "images"
) -> Path:
    """The folder to read images from.

    `images` names it. Otherwise with `width`, pixels: the one with the smallest images that are
    all at least so wide. Otherwise the first factor of `habit` that is there, or the one with the
    smallest factor. Raises InputError where there is none, or none is wide enough.
    """
    if images is not None:
        folder = root / images
        if not folder.is_dir():
            raise InputError(folder, "no such folder", f"a folder of images; here are {contents(root)}")
        if not image_files(folder):
            raise InputError(folder, "no images", f"images ({', '.join(IMAGE_SUFFIXES)})")
        return folder
    folders = image_folders(root, base)
    if not folders:
        raise InputError(root, contents(root), f"a folder {base} or {base}_N with images")
    if width is None:
        return next((folders[factor] for factor in habit if factor in folders), folders[min(folders)])
    narrowest = {folder: min(image_size(file)[0] for file in image_files(folder)) for folder in folders.values()}
    wide_enough = [folder for folder, pixels in narrowest.items() if pixels >= width]
    if not wide_enough:
        largest = max(narrowest, key=narrowest.__getitem__)
        raise InputError(
            largest, f"images {narrowest[largest]} pixels wide", f"at least the {width} asked for: nothing is enlarged"
        )
    return min(wide_enough, key=lambda folder: (narrowest[folder], folder.name))


@dataclass(frozen=True)
class MatchedFiles:
    """files: one a name, None where the folder has none for it. other_format: how many have another suffix than their
    name has."""

    files: tuple[Path | None, ...]
    other_format: int

    def present(self) -> list[int]:
        """Indices of the names that have a file."""
        return [index for index, file in enumerate(self.files) if file is not None]


def find_matches(folder: Path, names: Sequence[str], subject: object, *, by_order: bool = False) -> MatchedFiles:
    """The file in `folder` of every name in `names`, by the rule of `name_match`.

    names: paths relative to the image folder, or with its name before them (`images/a.png`). With `by_order` (LLFF,
    whose smaller copies may be renumbered), where no name is found and there are as many files as names: both in sorted
    order. Raises InputError for a name that means several files, and for a file that several names mean.
    """
    return _matched(folder, image_files(folder), names, subject, by_order)


def is_scaled(folder: Path) -> bool:
    """Whether a folder is called as one of scaled copies: images_8."""
    return _FACTOR.search(folder.name) is not None


def find_files(root: Path, paths: Sequence[str], subject: object) -> MatchedFiles:
    """As `find_matches`, for paths relative to the scene folder: only the folders that they name are looked into."""
    exact = [root / path for path in paths]
    if all(file.is_file() for file in exact):
        return MatchedFiles(tuple(exact), 0)
    folders = sorted({file.parent for file in exact if file.parent.is_dir()})
    files = [file for folder in folders for file in sorted(folder.iterdir()) if _is_image(file.name) and file.is_file()]
    return _matched(root, files, paths, subject, by_order=False)


def _is_image(name: str) -> bool:
    return not name.startswith(".") and Path(name).suffix.lower() in IMAGE_SUFFIXES


def _matched(
    folder: Path, files: Sequence[Path], names: Sequence[str], subject: object, by_order: bool
) -> MatchedFiles:
    paths = [path.relative_to(folder).as_posix() for path in files]
    whole = _FACTOR.sub("", folder.name)
    index = ImageNames([(path, f"{folder.name}/{path}", f"{whole}/{path}") for path in paths])
    found = [index.find(name) for name in names]
    if by_order and len(files) == len(names) and not any(match.images for match in found):
        ranks = {name: rank for rank, name in enumerate(sorted(names))}
        return MatchedFiles(tuple(files[ranks[name]] for name in names), 0)
    several = [name for name, match in zip(names, found, strict=True) if len(match.images) > 1]
    if several:
        raise InputError(folder, f"several images for {listed(several)}", f"one image for every name in {subject}")
    owners: dict[int, str] = {}
    for name, match in zip(names, found, strict=True):
        for image in match.images:
            if image in owners:
                both = f"{paths[image]} for both {owners[image]} and {name}"
                raise InputError(folder, both, f"an image of its own for every name in {subject}")
            owners[image] = name
    matched = tuple(files[match.images[0]] if match.images else None for match in found)
    changed = sum(
        file is not None and PurePosixPath(name).suffix.lower() not in ("", file.suffix.lower())
        for name, file in zip(names, matched, strict=True)
    )
    return MatchedFiles(matched, changed)


def match_files(folder: Path, names: Sequence[str], subject: object, *, by_order: bool = False) -> list[Path]:
    """The file in `folder` of every name, as `find_matches`. Raises InputError as it does, and where any has none."""
    matched = find_matches(folder, names, subject, by_order=by_order)
    refuse_missing(folder, names, matched, subject)
    return [file for file in matched.files if file is not None]


class MissingImages(InputError):
    """Images that a scene names and that aren't there, where others are: --skip-missing reads those."""


def refuse_missing(folder: Path, names: Sequence[str], matched: MatchedFiles, subject: object) -> None:
    """Raise InputError, which names the option that skips them, where a name has no file."""
    missing = [name for name, file in zip(names, matched.files, strict=True) if file is None]
    if missing:
        expected = f"every image that {subject} names"
        others = len(names) - len(missing)
        hint = f"; make-dataset --skip-missing reads the other {others}" if others else ""
        error = MissingImages if others else InputError
        raise error(folder, f"no image for {listed(missing)}", expected + hint)


def view_names(files: Sequence[str]) -> list[str]:
    """One unique view name a file (paths with '/' between parts): the stem where stems are unique.

    Otherwise, for all files alike, the whole path with '_' for '/', without suffix, then with it
    as '_png'; what still clashes is numbered in order.
    """
    paths = [PurePosixPath(file) for file in files]
    relative = ["_".join(part for part in path.parts if part not in ("/", "..")) for path in paths]
    candidates = (
        [path.stem for path in paths],
        [name[: len(name) - len(path.suffix)] for name, path in zip(relative, paths, strict=True)],
        [name.replace(".", "_") for name in relative],
    )
    for names in candidates:
        if len(set(names)) == len(names):
            return names
    digits = len(str(len(files)))
    return [f"{name}_{index:0{digits}d}" for index, name in enumerate(candidates[-1])]


def marked_hold(root: Path) -> int | None:
    """N of a marker file `hold=N` in the scene folder (Deblur-NeRF's habit); None without one."""
    found = [int(match[1]) for path in root.iterdir() if (match := _HOLD.fullmatch(path.name))]
    if len(found) > 1:
        raise InputError(root, f"{len(found)} marker files hold=N", "one at most")
    return found[0] if found else None


def contents(root: Path) -> str:
    """What a folder holds, for a message."""
    return listed(sorted(path.name for path in root.iterdir() if not path.name.startswith("."))) or "an empty folder"
