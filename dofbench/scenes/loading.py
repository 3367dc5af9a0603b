"""`load_scene`: find out the layout of a folder, read it, set the split."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from dofbench.errors import InputError
from dofbench.scenes.folders import contents, marked_hold
from dofbench.scenes.types import Scene

# In the order of detection. transforms.json says most (a camera a view, distortion, depth, split);
# an LLFF folder nearly always has a COLMAP model as well, and its poses are the ones scores are published for.
LAYOUTS = ("nerfstudio", "llff", "colmap")
DEFAULT_HOLD = 8
_MARKS = {
    "nerfstudio": "transforms.json",
    "llff": "poses_bounds.npy",
    "colmap": "sparse/0 or sparse with a COLMAP model",
}


def load_scene(
    root: Path,
    *,
    width: int | None = None,
    images: str | None = None,
    layout: str = "auto",
    hold: int | None = None,
) -> Scene:
    """Read a scene folder: views sorted by name, with lazy images, OpenCV cameras, sparse points, a split.

    width: of every view, pixels; height follows the aspect ratio, rounded to nearest. Images are
    shrunk by area averaging, and never enlarged. None keeps the size of the files.
    images: the image folder's name. Without it, and with a width, the folder with the smallest
    images that are wide enough; without both, LLFF takes images_8, else images_4, else images;
    COLMAP takes images, else the one with the smallest factor; nerfstudio takes the files as transforms.json has them.
    layout: one of `LAYOUTS`, or "auto": the first of transforms.json, poses_bounds.npy, sparse/0, sparse.
    hold: every hold-th view from the first is a test view. None: transforms.json's
    train_filenames and test_filenames, else a marker file `hold=N` in the folder, else 8.

    Distortion is taken out of images, depth and intrinsics here. Every image's existence and size
    are checked, its pixels are read by `SceneView.image()`. Raises InputError for whatever doesn't fit.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputError(root, "no such folder", "a scene folder")
    if width is not None and width < 1:
        raise InputError("width", str(width), "at least 1 pixel")
    chosen = _detect(root) if layout == "auto" else layout
    if chosen not in LAYOUTS:
        raise InputError("layout", repr(layout), f"auto, {', '.join(LAYOUTS)}")
    read: Callable[..., tuple[Scene, bool]] = import_module(f"dofbench.scenes.{chosen}").read
    scene, has_split = read(root, width=width, images=images)
    if hold is None:
        if has_split:
            return scene
        hold = marked_hold(root)
    return scene.with_hold(DEFAULT_HOLD if hold is None else hold)


def _detect(root: Path) -> str:
    for layout in LAYOUTS:
        if import_module(f"dofbench.scenes.{layout}").fits(root):
            return layout
    expected = "; or ".join(f"{_MARKS[layout]} ({layout})" for layout in LAYOUTS)
    raise InputError(root, contents(root), expected)
