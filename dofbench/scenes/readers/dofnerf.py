"""DoF-NeRF's layout (Wu et al. 2022): LLFF's, with one all-in-focus and two shallow photographs a view.

The folders f11, f4_bak and f4_obj stand in images, images_8, ...; the i-th file of each, in sorted order, was taken
from the i-th pose, as in the authors' published loader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.scenes.readers import llff
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.readers.colmap_places import find_model
from dofbench.scenes.readers.folders import choose_folder, image_files, image_folders, marked_hold
from dofbench.scenes.scene import Scene
from dofbench.scenes.views import Frame, assemble, check_inside, split_rule

# The paper holds out a ninth of the views.
DEFAULT_HOLD = 9
_SHARP, _BACKGROUND, _FOREGROUND = "f11", "f4_bak", "f4_obj"
_STACKS = (_SHARP, _BACKGROUND, _FOREGROUND)
_HABIT = (8, 4, 1)


def fits(root: Path) -> bool:
    """Whether the folder has LLFF's poses and, in a folder of images, the three folders."""
    folders = image_folders(root) if llff.fits(root) else {}
    return any(all((folder / stack).is_dir() for stack in _STACKS) for folder in folders.values())


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Views 1, hold + 1, 2 hold + 1, ... are test views (as the authors count), each its sharp photograph; training views
    of odd number are focused on the background, of even number on the foreground. hold: without it the marker's, else
    9. images: a folder with the three in it; or one of the three, such as images_8/f11 (f11: the one that fits the
    width), read as an LLFF scene. skip_missing: without effect, as no file names the images.
    """
    if images is not None and Path(images).name in _STACKS:
        return _one_stack(root, images, width, hold)
    folder = choose_folder(root, width=width, images=images, habit=_HABIT)
    stacks = {stack: _files(folder / stack) for stack in _STACKS}
    hold, by = _held(root, len(stacks[_SHARP]), hold)
    posed = {stack: llff.posed_frames(root, folder / stack, files) for stack, files in stacks.items()}
    # Every view has the name of its sharp photograph, whichever of its three photographs is read.
    frames = []
    for index, sharp in enumerate(posed[_SHARP]):
        stack = _SHARP if index % hold == 1 else _BACKGROUND if index % 2 else _FOREGROUND
        frames.append(replace(posed[stack][index], name=sharp.name))
    scene = _scene(root, folder / _SHARP, stacks[_SHARP], frames, hold, width)
    return replace(scene, split_by=by).taken_as(train="shallow", test="all-in-focus")


def _one_stack(root: Path, images: str, width: int | None, hold: int | None) -> Scene:
    stack = Path(images).name
    if images == stack:
        folder = choose_folder(root, width=width, images=None, habit=_HABIT) / stack
    else:
        folder = choose_folder(root, width=None, images=images, habit=())
    files = _files(folder)
    hold, by = _held(root, len(files), hold)
    scene = _scene(root, folder, files, llff.posed_frames(root, folder, files), hold, width)
    scene = replace(scene, split_by=by)
    return scene if stack == _SHARP else scene.taken_as(train="shallow", test="shallow")


def _scene(
    root: Path, folder: Path, files: Sequence[Path], frames: Sequence[Frame], hold: int, width: int | None
) -> Scene:
    model = find_model(root)
    points = llff.tracked_points(read_model(model), folder, files) if model else None
    frames = [replace(frame, split="test" if index % hold == 1 else "train") for index, frame in enumerate(frames)]
    scene = assemble(root, "dofnerf", frames, points, width=width, subject=root / llff.FILE)
    check_inside(scene, model)
    return scene


def _files(folder: Path) -> list[Path]:
    files = image_files(folder) if folder.is_dir() else []
    if not files:
        raise InputError(folder, "no images", f"photographs, as in each of {', '.join(_STACKS)}")
    return files


def _held(root: Path, count: int, asked: int | None) -> tuple[int, str]:
    """(hold, rule of the split). Raises InputError for a hold that leaves no view of either kind."""
    marked = marked_hold(root) if asked is None else None
    hold = next(value for value in (asked, marked, DEFAULT_HOLD) if value is not None)
    if hold < 2 or count < 2:
        found = f"hold {hold} for {count} view{'s' if count != 1 else ''}"
        raise InputError(root, found, "hold of at least 2 and two views or more: one to train, one to test")
    return hold, split_rule(asked, marked, DEFAULT_HOLD)
