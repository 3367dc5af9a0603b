"""Whether the views that a marker file hold=N points at are sharp ones among blurred ones, as Deblur-NeRF has them.

The marker alone doesn't say: it may stand in a folder whose photographs are all sharp. So the images are measured.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dofbench.core.images import read_image, resize
from dofbench.optics.blur_width import LUMA, blur_deviation
from dofbench.scenes.scene import Scene, SceneView

# Views measured of either kind, at this width in pixels, so that it takes seconds.
_MOST, _WIDTH = 16, 504
# Pixels with detail that a view must have to be judged.
_LEAST = 100
# Views of one scene are blurred alike within a quarter where all are sharp; a pixel of blur is a deviation of a half.
_RATIO, _GAP = 1.25, 0.15
# The share of pairs of a marked view and another in which the marked one is the sharper.
_PAIRS = 0.9


def marked_are_sharper(scene: Scene, hold: int) -> bool:
    """Whether views 0, hold, 2 hold, ... are clearly sharper than the others. False where it can't be seen.

    Raises InputError for an image that can't be read.
    """
    marked = _blur([view for index, view in enumerate(scene.views) if index % hold == 0])
    others = _blur([view for index, view in enumerate(scene.views) if index % hold])
    if not len(marked) or not len(others):
        return False
    sharp, blurred = np.median(marked), np.median(others)
    pairs = (marked[:, None] < others[None, :]).mean()
    return bool(pairs >= _PAIRS and blurred > _RATIO * sharp and blurred > sharp + _GAP)


def _blur(views: Sequence[SceneView]) -> np.ndarray:
    """Typical blur of each of some views, px of standard deviation at the width of measuring; views without detail are
    dropped."""
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
