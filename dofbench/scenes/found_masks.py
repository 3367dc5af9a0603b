"""Masks that no pose file names: in a folder masks/ next to the images, or in an alpha channel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.masks import has_alpha, read_opaque
from dofbench.scenes.on_disk import ImageOnDisk, MaskOnDisk, check_size
from dofbench.scenes.readers.folders import IMAGE_SUFFIXES, image_files, listed
from dofbench.scenes.scene import Alpha, Scene, SceneView

ALPHAS: tuple[Alpha, ...] = ("mask", "background")
FOLDER = "masks"


def with_masks(scene: Scene, alpha: Alpha | None) -> Scene:
    """The scene with masks from a folder masks/ or alpha channels, and notes on them. A mask named in transforms.json
    wins.

    alpha: meaning of an alpha channel; None is a mask, with a note on the alternative. Raises InputError for a mask of
    another shape than its image, or one that may belong to several images.
    """
    images = {view.name: view.image for view in scene.views if isinstance(view.image, ImageOnDisk)}
    beside = masks_beside(scene.root, [view.source for view in scene.views])
    clear = {view.name for view in scene.views if view.name in images and translucent(view.source)}
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
        image = replace(image, mask=mask)
        views.append(replace(view, mask=mask, image=image, linear=None if view.linear is None else image.light))
        found.append(view)
    return replace(scene, views=tuple(views)).noted(
        _masks_note([view.name for view in views if view.mask is not None], scene.views),
        alpha_note(len(clear), alpha),
        "" if found or any(beside) else _strangers(scene),
    )


def masks_beside(root: Path, files: Sequence[Path]) -> list[Path | None]:
    """The mask of each image file, at the same place in a folder masks/ below `root`: NAME.SUFFIX.png (COLMAP) or NAME
    with any image suffix; None without. Raises InputError where a mask's owner is ambiguous."""
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


def translucent(file: Path) -> bool:
    """Whether an image has an alpha channel that isn't 1 everywhere."""
    opaque = read_opaque(file) if has_alpha(file) else None
    return opaque is not None and not bool(opaque.all())


def _masks_note(masked: Sequence[str], views: Sequence[SceneView]) -> str:
    if not masked:
        return ""
    without = [view.name for view in views if view.name not in set(masked)]
    note = f"masks of {len(masked)} of {len(views)} views: masked pixels are neither trained on nor scored"
    return f"{note}; unmasked: {listed(without)}" if without else note


def alpha_note(count: int, alpha: Alpha | None) -> str:
    """What is said of `count` images with an alpha channel; "" for none."""
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
