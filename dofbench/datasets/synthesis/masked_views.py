"""Masks of a dataset's views: those of the scene, and after blurring the pixels that masked ones reach as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.masks import write_mask
from dofbench.datasets.format import layout
from dofbench.datasets.format.schema import ViewRecord
from dofbench.datasets.format.sensor import Sensor
from dofbench.datasets.synthesis.render_views import Photography, shallow_image
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.scene import Scene, SceneView

# Share of a blurred pixel's light that may come from masked pixels, whose colour is unknown: with more it is masked.
REACHED = 0.01


def write_view_masks(
    scene: Scene, out: Path, changed: Callable[[SceneView, np.ndarray], np.ndarray], at_once: int
) -> None:
    """Write the mask of every view that has masked pixels, unless it is there.

    changed: gives the mask to write, (H, W) bool, for a view and the scene's mask of it. at_once: views at a time.
    """

    def write_one(view: SceneView) -> None:
        path = layout.mask_path(out, view.name)
        if view.mask is not None and not path.is_file() and not (mask := view.mask()).all():
            write_mask(path, changed(view, mask))

    for _ in over_views(write_one, scene.views, at_once):
        pass


def unreached(mask: np.ndarray, depth: np.ndarray, record: ViewRecord, shared: Photography) -> np.ndarray:
    """The mask of a blurred view: valid pixels of which at most `REACHED` of the light comes from masked pixels.

    mask: (H, W) bool, of the all-in-focus image. The masked pixels are spread by the view's own lens. Raises
    InputError if no pixel is left.
    """
    if record.aperture == 0:
        return mask
    blur = shared.blur
    if blur.renderer == "thinlens":
        blur = replace(blur, renderer="scatter")
    spread = np.repeat(np.where(mask, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    _, share = shallow_image(spread, depth, record, replace(shared, blur=blur, sensor=Sensor()))
    clear = mask & (share[..., 0] <= REACHED)
    if not clear.any():
        found = f"every pixel masked, or reached by masked ones through a blur of up to {record.max_coc_px:.1f} px"
        raise InputError(f"view {record.name}", found, "some pixels to train on: a smaller mask or aperture")
    return clear
