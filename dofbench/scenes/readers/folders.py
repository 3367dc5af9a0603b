"""Find the images of a scene folder: which folder, which file of which camera, what the views are called."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError, first_line
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
NOTHING_ENLARGED = "at least the {} asked for: nothing is enlarged"
# COLMAP numbers what it makes inside these: sparse/0, and undistorted images with their model in dense/0.
_MADE_BY_COLMAP = ("sparse", "dense")
# Images that capture apps and photogrammetry programs write next to photographs.
_KIND = (
    "masks?|depths?|depth_?maps?|conf|confs|confidences?|confidence_?maps?|normals?|normal_?maps?|disparity|disparities|"
    "segmentations?|semantics?|labels?|alphas?|mattes?"
)
# A folder such as masks, masks_4, depth_png, lidar_depth or dynamic-masks.
_COMPANIONS = re.compile(rf"(?:[a-z0-9]+[_-])?(?:{_KIND})(?:[_-](?:\d+|png|exr|tiff?|jpe?g|images?))?", re.IGNORECASE)
# A file such as IMG_0_mask.png or 12.depth.png, next to IMG_0.png or 12.png.
_COMPANION = re.compile(rf"(.+)[._-](?:{_KIND})", re.IGNORECASE)


def scene_name(folder: Path) -> str:
    """The name of a scene: its folder's, or that of the first one above not named by COLMAP."""
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


def contents(root: Path) -> str:
    """The content of a folder, for a message."""
    return listed(sorted(path.name for path in root.iterdir() if not path.name.startswith("."))) or "an empty folder"


def image_header(file: Path) -> Any | None:
    """OpenImageIO's ImageSpec of a file; None where it can't be opened."""
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(file))
    if opened is None:
        first_line(oiio.geterror)  # else it is kept, and printed when the program ends
        return None
    header = opened.spec()
    opened.close()
    return header


def _files(folder: Path) -> list[Path]:
    """All files under `folder` that aren't hidden."""
    found = []
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(parent, name) for name in names if not name.startswith(".")]
    return found


def _is_image(path: Path) -> bool:
    return not path.name.startswith(".") and path.suffix.lower() in IMAGE_SUFFIXES


def image_files(folder: Path) -> list[Path]:
    """Image files under `folder`, with sub-folders, sorted by relative path; hidden ones are excluded.

    Of a photograph in a camera's format (HEIC, AVIF, raw) and, by the same name, in a plain one, the plain one. Raises
    InputError for one that is no regular file: a FIFO, a socket, a dangling link.
    """
    found = [path for path in _files(folder) if _is_image(path)]
    for path in found:
        check_file(path, "an image file")
    plain = {path.with_suffix("") for path in found if not is_camera_file(path)}
    found = [path for path in found if not (is_camera_file(path) and path.with_suffix("") in plain)]
    return sorted(found, key=lambda path: path.relative_to(folder).as_posix())


def other_files(folder: Path) -> list[Path]:
    """Files under `folder`, with sub-folders, that `image_files` excludes; without hidden ones and text."""
    taken = set(image_files(folder))
    found = (path for path in _files(folder) if path not in taken and path.suffix.lower() not in _TEXT_SUFFIXES)
    return sorted(found)


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


def is_scaled(folder: Path) -> bool:
    """Whether a folder is named like one of scaled copies: images_8."""
    return _FACTOR.search(folder.name) is not None


def choose_folder(
    root: Path, *, width: int | None, images: str | None, habit: Sequence[int], base: str = "images"
) -> Path:
    """The folder to read images from: `images`; else with `width` (pixels) the one with the smallest images at least so
    wide; else the first factor of `habit` that exists, or the smallest factor.

    Raises InputError where there is none, or none is wide enough.
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
        raise InputError(largest, f"images {narrowest[largest]} pixels wide", NOTHING_ENLARGED.format(width))
    return min(wide_enough, key=lambda folder: (narrowest[folder], folder.name))


def photographs_of(source: Path, images: str | None) -> tuple[Path, list[Path], list[str]]:
    """The photographs of a folder without poses: their folder, their files, and a note on other images.

    images: the folder within `source`; without it the largest of `images`, `images_4` and the like, else the source.
    Raises InputError where there is no such folder.
    """
    folder = source
    if images is not None or image_folders(source):
        folder = choose_folder(source, width=None, images=images, habit=())
    files, aside = without_companions(folder, image_files(folder))
    return folder, files, aside


def without_companions(folder: Path, files: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """The photographs among the image files below `folder`, without masks, depth maps and the like, and a note on
    those.

    A companion is named like one, itself or its folder, and next to photographs: one of the folder's images has the
    name of a photograph, or all of them are grey.
    """
    inside: dict[str, list[Path]] = {}
    for file in files:
        parts = file.relative_to(folder).parts
        if any(_COMPANIONS.fullmatch(part) for part in parts[:-1]):
            inside.setdefault(parts[0], []).append(file)
    named = {file for those in inside.values() for file in those}
    outside = {file.stem for file in files if file not in named}
    # A folder of photographs may be called "depth", too: then nothing else has the names of what is in it.
    places = {
        place
        for place, those in inside.items()
        if outside and (any(_stems(file) & outside for file in those) or all(_grey(file) for file in those))
    }
    paths = {(file.parent, file.stem.lower()) for file in files}
    kept, aside = [], Counter[str]()
    for file in files:
        first = file.relative_to(folder).parts[0]
        suffixed = _COMPANION.fullmatch(file.stem)
        if file in named and first in places:
            aside[f"in {first}/"] += 1
        elif suffixed is not None and (file.parent, suffixed[1].lower()) in paths:
            aside["by the end of their names"] += 1
        else:
            kept.append(file)
    counted = ", ".join(f"{count} {place}" for place, count in sorted(aside.items()))
    return kept, [f"not taken for photographs, as masks, depth or the like: {counted}"] if aside else []


def _stems(file: Path) -> set[str]:
    suffixed = _COMPANION.fullmatch(file.stem)
    return {file.stem, Path(file.stem).stem, *([suffixed[1]] if suffixed else [])}


def _grey(file: Path) -> bool:
    header = image_header(file)
    return header is not None and header.nchannels == 1


@dataclass(frozen=True)
class MatchedFiles:
    """files: one for each name, None where missing. other_format: how many have another suffix than their name."""

    files: tuple[Path | None, ...]
    other_format: int

    def present(self) -> list[int]:
        """Indices of the names that have a file."""
        return [index for index, file in enumerate(self.files) if file is not None]

    def found(self) -> list[Path]:
        """The files that aren't missing."""
        return [file for file in self.files if file is not None]

    def missing(self, names: Sequence[str]) -> list[str]:
        """The entries of `names` that have no file."""
        return [name for name, file in zip(names, self.files, strict=True) if file is None]


def find_matches(folder: Path, names: Sequence[str], subject: object, *, by_order: bool = False) -> MatchedFiles:
    """The file in `folder` of every name, by the rule of `name_match`.

    names: paths relative to the image folder, or with its name before them (`images/a.png`). by_order: where no name is
    found and there are as many files as names, match both in sorted order (LLFF's smaller copies may be renumbered).
    Raises InputError for a name that means several files, and for a file that several names mean.
    """
    return _matched(folder, image_files(folder), names, subject, by_order)


def find_files(root: Path, paths: Sequence[str], subject: object) -> MatchedFiles:
    """As `find_matches`, for paths relative to the scene folder: only folders that they name are searched."""
    exact = [root / path for path in paths]
    if all(file.is_file() for file in exact):
        return MatchedFiles(tuple(exact), 0)
    folders = sorted({file.parent for file in exact if file.parent.is_dir()})
    files = [file for folder in folders for file in sorted(folder.iterdir()) if _is_image(file) and file.is_file()]
    return _matched(root, files, paths, subject, by_order=False)


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
    """The file in `folder` of every name, as `find_matches`. Raises InputError also where one is missing."""
    matched = find_matches(folder, names, subject, by_order=by_order)
    refuse_missing(folder, names, matched, subject)
    return matched.found()


class MissingImages(InputError):
    """Some images that a scene names are missing: --skip-missing reads the others."""


def refuse_missing(folder: Path, names: Sequence[str], matched: MatchedFiles, subject: object) -> None:
    """Raise InputError, which names the option that skips them, where a name has no file."""
    if missing := matched.missing(names):
        others = len(names) - len(missing)
        hint = f"; make-dataset --skip-missing reads the other {others}" if others else ""
        error = MissingImages if others else InputError
        raise error(folder, f"no image for {listed(missing)}", f"every image that {subject} names{hint}")


def without_pose(folder: Path, used: Iterable[Path], poses: object) -> str:
    """A note on image files of a folder without a pose in `poses` (a file or model); empty without any."""
    files, known = image_files(folder), set(used)
    unused = [path.relative_to(folder).as_posix() for path in files if path not in known]
    posed = f"{len(files)} images in {folder.name}, {len(files) - len(unused)} with a pose in {poses}"
    return f"{posed}: {len(unused)} not used ({listed(unused)})" if unused else ""


def skipped(names: Sequence[str], matched: MatchedFiles, poses: object) -> str:
    """A note on poses without an image file; empty without any."""
    missing = matched.missing(names)
    note = f"{len(names)} poses in {poses}, {len(missing)} without an image, skipped: {listed(missing)}"
    return note if missing else ""


def fewer_points(points: PointCloud | None, kept: PointCloud | None) -> str:
    """A note on points that no remaining view saw; empty without any."""
    if points is None or kept is None or len(kept) == len(points):
        return ""
    return f"{len(points)} points, {len(points) - len(kept)} that no remaining view saw: skipped"


def other_format(matched: MatchedFiles, folder: Path, poses: object) -> str:
    """A note on images with another suffix than their names in `poses`; empty without any, and for a folder of scaled
    copies (images_8), which often have one."""
    if not matched.other_format or is_scaled(folder):
        return ""
    return f"{matched.other_format} of {len(matched.files)} images have another suffix than their names in {poses}"


def view_names(files: Sequence[str]) -> list[str]:
    """One unique view name a file (paths with '/' between parts): the stem where stems are unique.

    Otherwise, for all files alike, the whole path with '_' for '/', without suffix, then with it as '_png'; clashing
    names are numbered in order.
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
    """N of a marker file `hold=N` in the scene folder (Deblur-NeRF); None without one."""
    found = [int(match[1]) for path in root.iterdir() if (match := _HOLD.fullmatch(path.name))]
    if len(found) > 1:
        raise InputError(root, f"{len(found)} marker files hold=N", "one at most")
    return found[0] if found else None
