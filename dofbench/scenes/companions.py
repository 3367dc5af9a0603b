"""Images that belong to photographs and are none: masks, depth, confidence maps and the like, as capture apps and
photogrammetry programs leave them next to the photographs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dofbench.scenes.readers.folders import choose_folder, image_files, image_folders

_KIND = (
    "masks?|depths?|depth_?maps?|conf|confs|confidences?|confidence_?maps?|normals?|normal_?maps?|disparity|disparities|"
    "segmentations?|semantics?|labels?|alphas?|mattes?"
)
# A folder such as masks, masks_4, depth_png, lidar_depth or dynamic-masks.
_FOLDER = re.compile(rf"(?:[a-z0-9]+[_-])?(?:{_KIND})(?:[_-](?:\d+|png|exr|tiff?|jpe?g|images?))?", re.IGNORECASE)
# A file such as IMG_0_mask.png or 12.depth.png, next to IMG_0.png or 12.png.
_FILE = re.compile(rf"(.+)[._-](?:{_KIND})", re.IGNORECASE)


def photographs_of(source: Path, images: str | None) -> tuple[Path, list[Path], list[str]]:
    """The photographs of a folder without poses: where they are, their files, and a note on images that are none.

    images: the folder within `source`. Without it, where there are `images`, `images_4` and the like: the one with the
    largest; else the source itself. Raises InputError where there is no such folder.
    """
    folder = source
    if images is not None or image_folders(source):
        folder = choose_folder(source, width=None, images=images, habit=())
    files, aside = without_companions(folder, image_files(folder))
    return folder, files, aside


def without_companions(folder: Path, files: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """The photographs among the image files below `folder`, and a note on the others where there are any.

    A file counts as a companion where its folder or the end of its name says so, and there are photographs besides: of
    the same name as one of the folder's images, or all of the folder's images being grey.
    """
    outside = {file.stem for file in files if not _named_folder(folder, file)}
    inside: dict[str, list[Path]] = {}
    for file in files:
        if _named_folder(folder, file):
            inside.setdefault(file.relative_to(folder).parts[0], []).append(file)
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
        suffixed = _FILE.fullmatch(file.stem)
        if _named_folder(folder, file) and first in places:
            aside[f"in {first}/"] += 1
        elif suffixed is not None and (file.parent, suffixed[1].lower()) in paths:
            aside["by the end of their names"] += 1
        else:
            kept.append(file)
    if not aside:
        return list(files), []
    counted = ", ".join(f"{count} {place}" for place, count in sorted(aside.items()))
    return kept, [f"not taken for photographs, as masks, depth or the like: {counted}"]


def _named_folder(folder: Path, file: Path) -> bool:
    return any(_FOLDER.fullmatch(part) for part in file.relative_to(folder).parts[:-1])


def _stems(file: Path) -> set[str]:
    suffixed = _FILE.fullmatch(file.stem)
    return {file.stem, Path(file.stem).stem, *([suffixed[1]] if suffixed else [])}


def _grey(file: Path) -> bool:
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(file))
    if opened is None:
        oiio.geterror()
        return False
    channels = opened.spec().nchannels
    opened.close()
    return channels == 1
