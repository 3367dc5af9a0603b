"""Deblur-NeRF's layout (Ma et al. 2022): LLFF's, with blurred training views and sharp test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, resize
from dofbench.optics.blur_width import LUMA, blur_deviation
from dofbench.scenes.readers import llff
from dofbench.scenes.readers.folders import choose_folder, marked_hold
from dofbench.scenes.scene import Scene, SceneView
from dofbench.scenes.views import split_rule

# Views measured of either kind, at this width in pixels, so that it takes seconds.
_MOST, _WIDTH = 16, 504
# Pixels with detail that a view must have to be judged.
_LEAST = 100
# Views of one scene are blurred alike within a quarter where all are sharp; a pixel of blur is a deviation of a half.
_RATIO, _GAP = 1.25, 0.15
# The share of pairs of a marked view and another in which the marked one is the sharper.
_PAIRS = 0.9


def fits(root: Path) -> bool:
    """Never: no file tells the layout from LLFF's, as the marker hold=N may stand in any folder."""
    return False


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Views 0, hold, 2 hold, ... are sharp, all others blurred; hold is given or marked, never guessed. Without width and
    images: images_4, where it exists (the real scenes are read at a quarter of their size), else images.
    """
    marked = marked_hold(root) if hold is None else None
    chosen = marked if hold is None else hold
    if chosen is None:
        raise InputError(root, "no marker file hold=N and no hold", "one of them: it says which photographs are sharp")
    folder = choose_folder(root, width=width, images=images, habit=(4, 1))
    scene = llff.read_folder(root, folder, width=width, skip_missing=skip_missing).with_hold(chosen)
    scene = replace(scene, split_by=split_rule(hold, marked, chosen), layout="deblurnerf")
    return scene.taken_as(train="shallow", test="all-in-focus")


def marked_are_sharper(scene: Scene, hold: int) -> bool:
    """Whether views 0, hold, 2 hold, ... are clearly sharper than the others; measured, as a marker may also stand in a
    folder of sharp images. False where it can't be measured. Raises InputError for an unreadable image."""
    marked = _blur([view for index, view in enumerate(scene.views) if index % hold == 0])
    others = _blur([view for index, view in enumerate(scene.views) if index % hold])
    if not len(marked) or not len(others):
        return False
    sharp, blurred = np.median(marked), np.median(others)
    pairs = (marked[:, None] < others[None, :]).mean()
    return bool(pairs >= _PAIRS and blurred > _RATIO * sharp and blurred > sharp + _GAP)


def _blur(views: Sequence[SceneView]) -> np.ndarray:
    """Median blur of each of some views with detail, px of standard deviation at the width of measuring."""
    chosen = np.unique(np.linspace(0, len(views) - 1, min(_MOST, len(views))).round().astype(int))
    found = []
    for index in chosen:
        # The file, whatever size the scene is read at: a blur of pixels is gone in a small copy.
        image = read_image(views[index].source)
        height, width = image.shape[:2]
        if width > _WIDTH:
            image = resize(image, _WIDTH, max(1, round(height * _WIDTH / width)))
        deviation = blur_deviation(image.astype(np.float64) @ LUMA)
        known = deviation[np.isfinite(deviation)]
        if len(known) >= _LEAST:
            found.append(float(np.median(known)))
    return np.array(found)
