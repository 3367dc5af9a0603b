"""DoF-NeRF's layout (Wu et al. 2022): LLFF's, with three photographs a view: one all in focus, two shallow.

The folders f11, f4_bak and f4_obj stand in images, images_8, ...; the i-th file of each, in sorted order, was taken
from the i-th pose. What is said of them here is read off the loader and the runner that its authors publish.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.scenes.readers import llff
from dofbench.scenes.readers.colmap_places import find_model
from dofbench.scenes.readers.folders import choose_folder, image_files, image_folders, marked_hold
from dofbench.scenes.scene import Scene, Split
from dofbench.scenes.views import Frame, assemble, check_inside

# The paper holds out a ninth of the views.
DEFAULT_HOLD = 9
_SHARP, _BACKGROUND, _FOREGROUND = "f11", "f4_bak", "f4_obj"
_STACKS = (_SHARP, _BACKGROUND, _FOREGROUND)


def fits(root: Path) -> bool:
    """Whether the folder has LLFF's poses and, in a folder of images, the three folders."""
    folders = image_folders(root) if llff.fits(root) else {}
    return any(all((folder / stack).is_dir() for stack in _STACKS) for folder in folders.values())


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Views 1, hold + 1, 2 hold + 1, ... are test views (the one after the first, as the authors count), each
    its sharp photograph; training views of odd number are focused on the background, of even number on the foreground.
    hold: where it isn't given, the marker's, else 9. images: a folder with the three in it; or one of the three,
    such as images_8/f11 (f11: the one that fits the width), read as an LLFF scene of its own. skip_missing: no file
    says which image is missing, so nothing is skipped.
    """
    if images is not None and Path(images).name in _STACKS:
        return _one_stack(root, images, width, hold)
    folder = choose_folder(root, width=width, images=images, habit=(8, 4, 1))
    stacks = {stack: _files(folder / stack) for stack in _STACKS}
    splits = _splits(root, len(stacks[_SHARP]), hold)
    frames = []
    posed = {stack: llff.posed_frames(root, folder / stack, files) for stack, files in stacks.items()}
    for index, split in enumerate(splits):
        shallow = _BACKGROUND if index % 2 else _FOREGROUND
        frame = posed[_SHARP if split == "test" else shallow][index]
        # Every view has the name of its sharp photograph, whichever of its three photographs is read.
        frames.append(replace(frame, name=posed[_SHARP][index].name, split=split))
    scene = _scene(root, folder / _SHARP, stacks[_SHARP], frames, width)
    return replace(scene, split_by=_split_by(root, hold)).taken_as(train="shallow", test="all-in-focus")


def _one_stack(root: Path, images: str, width: int | None, hold: int | None) -> Scene:
    stack = Path(images).name
    if images == stack:
        folder = choose_folder(root, width=width, images=None, habit=(8, 4, 1)) / stack
    else:
        folder = choose_folder(root, width=None, images=images, habit=())
    files = _files(folder)
    splits = _splits(root, len(files), hold)
    frames = [
        replace(frame, split=split) for frame, split in zip(llff.posed_frames(root, folder, files), splits, strict=True)
    ]
    scene = replace(_scene(root, folder, files, frames, width), split_by=_split_by(root, hold))
    return scene if stack == _SHARP else scene.taken_as(train="shallow", test="shallow")


def _scene(root: Path, folder: Path, files: Sequence[Path], frames: Sequence[Frame], width: int | None) -> Scene:
    model = find_model(root)
    points = llff.read_points(model, folder, files) if model else None
    scene = assemble(root, "dofnerf", frames, points, width=width, subject=root / "poses_bounds.npy")
    check_inside(scene, model)
    return scene


def _files(folder: Path) -> list[Path]:
    files = image_files(folder) if folder.is_dir() else []
    if not files:
        raise InputError(folder, "no images", f"photographs, as in each of {', '.join(_STACKS)}")
    return files


def _split_by(root: Path, hold: int | None) -> str:
    if hold is not None:
        return f"hold {hold} (as asked)"
    marked = marked_hold(root)
    return f"hold {DEFAULT_HOLD} (default)" if marked is None else f"hold {marked} (marker file)"


def _splits(root: Path, count: int, hold: int | None) -> list[Split]:
    marked = marked_hold(root) if hold is None else hold
    hold = DEFAULT_HOLD if marked is None else marked
    if hold < 2 or count < 2:
        found = f"hold {hold} for {count} view{'s' if count != 1 else ''}"
        raise InputError(root, found, "hold of at least 2 and two views or more: one to train, one to test")
    return ["test" if index % hold == 1 else "train" for index in range(count)]
