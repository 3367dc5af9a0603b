"""Load a scene folder: detect its layout, read it, set the split."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.scenes.found_masks import ALPHAS, with_masks
from dofbench.scenes.light_field.grid import GRID, LIGHT_FIELD, is_grid
from dofbench.scenes.local_frame import AnotherFrame
from dofbench.scenes.readers import colmap
from dofbench.scenes.readers.colmap_places import PLACES, scene_folder
from dofbench.scenes.readers.deblurnerf import marked_are_sharper
from dofbench.scenes.readers.folders import contents, image_files, listed, marked_hold, photographs_of
from dofbench.scenes.readers.nerfstudio import LISTS, listed_split
from dofbench.scenes.readers.poses import checked_poses, unchecked
from dofbench.scenes.readers.split_files import split_by
from dofbench.scenes.scene import Alpha, Scene
from dofbench.scenes.views import split_rule

# In the order of detection. transforms.json says most (a camera a view, distortion, depth, split);
# an LLFF folder nearly always has a COLMAP model as well, and its poses are the ones scores are published for.
_MARKS = {
    "nerfstudio": "transforms.json",
    "dofnerf": "poses_bounds.npy and images with f11, f4_bak, f4_obj",
    "llff": "poses_bounds.npy",
    "colmap": f"a COLMAP model in {PLACES}",
}
# Layouts that no file gives away: they are asked for by name, known of a named dataset, or measured.
UNMARKED = ("deblurnerf",)
LAYOUTS = (*_MARKS, *UNMARKED)
# Where a scene is looked for below a folder that is none, to name it.
_STEPS_DOWN, _FOLDERS = 2, 200
_printed: set[str] = set()


def load_scene(
    root: Path | str,
    *,
    width: int | None = None,
    images: str | None = None,
    layout: str = "auto",
    hold: int | None = None,
    alpha_channel: Alpha | None = None,
    skip_missing: bool = False,
) -> Scene:
    """Read a scene folder: views sorted by name, with lazy images, OpenCV cameras, sparse points, a split.

    root: the folder, or the place of its COLMAP model (sparse, sparse/0). The scene is named after the folder; where
    COLMAP named that (dense/0), after the one above. width: of every view, pixels; the aspect ratio is kept, images are
    shrunk by area averaging and never enlarged. None keeps the files' size.

    images: name of the image folder. Without it, and with a width, the folder with the smallest images that are wide
    enough; without both, LLFF takes images_8, else images_4, else images; COLMAP images, else the smallest factor;
    nerfstudio the files in transforms.json.

    layout: one of `LAYOUTS`, or "auto": the first of transforms.json, poses_bounds.npy, a COLMAP model. "deblurnerf" is
    LLFF's with a marker file hold=N and blurred training images: auto measures whether the marked views are clearly
    sharper, and asks for a layout where they aren't. A complete COLMAP model is read in place of a transforms.json in
    another frame, with a note.

    hold: every hold-th view from the first is a test view (dofnerf: from the second). None: transforms.json's lists,
    else test.txt, train.txt, split.json or train_test_lists.json in the folder or next to the COLMAP model, else a
    marker file `hold=N`, else 8 (dofnerf: 9; deblurnerf: an error). skip_missing: skip poses without an image file,
    with a note. alpha_channel: meaning of a translucent alpha channel: mask (None: the same, with a note), or
    background, composited over black.

    Masks come from transforms.json, else a folder masks/, and alpha (`found_masks.py`). Distortion is removed from
    images, depth and intrinsics. Existence and size of every image are checked; its pixels are read by
    `SceneView.image()`. Raises InputError for whatever doesn't fit.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputError(root, "no such folder", "a scene folder")
    root = scene_folder(root)
    if width is not None and width < 1:
        raise InputError("width", str(width), "at least 1 pixel")
    if layout == LIGHT_FIELD or (layout == "auto" and is_grid(root)):
        found = f"a light field ({GRID}), whose views have no poses"
        expected = f"a scene with camera poses; dofbench make-dataset {root} --photographs light-field finds them"
        raise InputError(root, found, expected)
    chosen = _detect(root) if layout == "auto" else layout
    if chosen not in LAYOUTS:
        raise InputError("layout", repr(layout), f"auto, {', '.join(LAYOUTS)}")
    if alpha_channel is not None and alpha_channel not in ALPHAS:
        raise InputError("alpha_channel", repr(alpha_channel), " or ".join(ALPHAS))
    options = {"width": width, "images": images, "hold": hold, "skip_missing": skip_missing}
    scene = _without_masks(root, layout, chosen, options)
    # A dataset of ours has the poses of a scene that has been through here.
    scene = scene if (root / "dataset.json").is_file() else checked_poses(scene)
    return with_masks(scene.noted(_lists_not_used(root, layout, scene)), alpha_channel)


def _without_masks(root: Path, layout: str, chosen: str, options: Mapping[str, int | str | None]) -> Scene:
    marked = marked_hold(root) if layout == "auto" and chosen == "llff" else None
    try:
        if marked is not None:
            return _marked(root, marked, options)
        scene = _read(chosen, root, **options)
        return scene if layout != "auto" else _with_sharp_ones(scene)
    except AnotherFrame as error:
        if chosen == "colmap" or not colmap.fits(root):
            raise
        model = _model_by_itself(root, error, **options) if layout == "auto" and chosen == "nerfstudio" else None
        if model is None:
            expected = f"{error.expected}; --layout colmap reads the COLMAP model by itself"
            raise InputError(error.subject, error.found, expected) from None
        return model


def _lists_not_used(root: Path, layout: str, scene: Scene) -> str:
    """A note on the split of a transforms.json where another layout was asked for; empty where it has none."""
    file = root / "transforms.json"
    if layout in ("auto", "nerfstudio") or scene.layout == "nerfstudio" or not file.is_file():
        return ""
    try:
        content = read_json(file)
        lists = listed_split(content, file) if isinstance(content, dict) else None
    except InputError:
        return f"{file.name} is not used, as --layout {layout} asks"
    return "" if lists is None else f"{LISTS} are not used for the split, as --layout {layout} asks"


def _marked(root: Path, marked: int, options: Mapping[str, int | str | None]) -> Scene:
    """Read an LLFF folder with a marker file hold=N as Deblur-NeRF's layout. Raises InputError where the marked views
    aren't clearly sharper, and for another hold than the marker's where they are."""
    scene = _read("deblurnerf", root, **{**options, "width": None, "hold": marked})
    if not marked_are_sharper(scene, marked):
        found = f"a marker file hold={marked}, and views 0, {marked}, {2 * marked}, ... no sharper than the others"
        expected = "--layout deblurnerf if the others are blurred all the same, or --layout llff if all are sharp"
        raise InputError(root, found, expected)
    if options["hold"] not in (None, marked):
        found = (
            f"{options['hold']} in {root}, where views 0, {marked}, {2 * marked}, ... are sharp and the others blurred"
        )
        raise InputError("--hold", found, f"{marked}, as its marker file says; or a --layout")
    return _read("deblurnerf", root, **options).noted(
        f"hold={marked} marks sharp views among blurred ones, as measured: read as --layout deblurnerf"
    )


def _with_sharp_ones(scene: Scene) -> Scene:
    """The scene of another layout with a marker file hold=N; its training views are shallow if the marked ones are
    clearly sharper."""
    marked = marked_hold(scene.root)
    if marked is None or scene.photographs != "all-in-focus" or scene.split_by != split_rule(None, marked, 0):
        return scene
    if not marked_are_sharper(scene, marked):
        return scene.noted(f"hold={marked} marks views that are no sharper than the others: read as all in focus")
    return scene.taken_as(train="shallow", test="all-in-focus").noted(
        f"hold={marked} marks sharp views among blurred ones, as measured: the others are trained on as they are"
    )


def _read(layout: str, root: Path, **options: int | str | None) -> Scene:
    read: Callable[..., Scene] = import_module(f"dofbench.scenes.readers.{layout}").read
    return read(root, **options)


def _model_by_itself(root: Path, error: AnotherFrame, **options: int | str | None) -> Scene | None:
    """The COLMAP model without the transforms.json that it contradicts, with a note; None where the model is
    unreadable, without points, or has fewer views than the file."""
    try:
        scene = _read("colmap", root, **options)
    except InputError:
        return None
    content = read_json(root / "transforms.json")
    if scene.points is None or len(scene.views) < len(content["frames"]):
        return None
    lists = listed_split(content, root / "transforms.json") if options["hold"] is None else None
    if lists is not None:
        scene = split_by(scene, [lists], {})
    used = "nothing" if lists is None else "nothing but the split"
    return scene.noted(
        f"transforms.json and the COLMAP model are in different frames ({error.subject}: {error.found}); "
        f"read as --layout colmap, with {used} from transforms.json"
    )


def print_notes(scene: Scene) -> None:
    """Print a scene's notes and split rule to standard error, each once per process."""
    split = f"split by {scene.split_by}"
    notes = scene.notes if any(note.startswith(split) for note in scene.notes) else (*scene.notes, split)
    for note in (*notes, *filter(None, [unchecked(scene)])):
        line = f"{scene.root}: {note}"
        if line not in _printed:
            _printed.add(line)
            print(line, file=sys.stderr, flush=True)


def detect(root: Path) -> str | None:
    """The layout by a folder's files; None where none fits."""
    return next((layout for layout in _MARKS if import_module(f"dofbench.scenes.readers.{layout}").fits(root)), None)


def _scenes_inside(root: Path) -> list[Path]:
    """Folders with poses below one without: the nearest, at most two steps down."""
    found: list[Path] = []
    level = [root]
    for _ in range(_STEPS_DOWN):
        below = [path for folder in level for path in sorted(folder.iterdir()) if _is_folder(path)][:_FOLDERS]
        found = [path for path in below if detect(path) is not None]
        if found:
            break
        level = below
    return found


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink() and not path.name.startswith(".") and os.access(path, os.R_OK)


def _detect(root: Path) -> str:
    layout = detect(root)
    if layout is not None:
        return layout
    inside = _scenes_inside(root)
    if inside:
        found = f"no poses, but scenes in {listed(path.relative_to(root).as_posix() for path in inside)}"
        raise InputError(root, found, f"the folder of one scene, as {inside[0]}")
    # Beside an incomplete COLMAP model the error is about the model, not about missing poses.
    if not (root / "sparse").is_dir() and image_files(root):
        _, photographs, aside = photographs_of(root, None)
        expected = f"a scene with camera poses: dofbench reconstruct {root} --out SCENE finds them"
        besides = f" ({aside[0]})" if aside else ""
        raise InputError(root, f"{len(photographs)} photographs without poses{besides}", expected)
    expected = "; or ".join(f"{_MARKS[layout]} ({layout})" for layout in _MARKS)
    raise InputError(root, contents(root), expected)
